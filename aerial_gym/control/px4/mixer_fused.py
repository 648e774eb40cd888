"""PX4's mixer for one environment in the fused kernel, the twin of ``control.px4.mixer``.

Letters: R rotors.
"""

import warp as wp

from aerial_gym.control.px4.mixer import PITCH, ROLL, THRUST, WEAK, YAW, YAW_MARGIN
from aerial_gym.physics.fused.allocation import NEGLIGIBLE
from aerial_gym.physics.fused.types import rotor_types


def make_mixer(num_rotors: int, general: bool, airmode: int) -> wp.Function:
    """Return ``mixer.mix``: from units of torque [N m] and thrust [N], normalised torque and thrust to thrusts [N] and signs.

    Args:
        general: Whether rotors are of any kind.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector
    columns_type = wp.types.matrix(shape=(4, num_rotors), dtype=wp.float32)

    @wp.func
    def room(signal: vector, column: vector, low: vector, margin: float) -> float:
        least = wp.float32(0.0)
        most = wp.float32(0.0)
        for i in range(wp.static(num_rotors)):
            beyond = wp.clamp(signal[i], low[i], 1.0 + margin * (1.0 - low[i])) - signal[i]
            if wp.abs(column[i]) >= wp.static(WEAK):
                least = wp.min(least, beyond / column[i])
                most = wp.max(most, beyond / column[i])
        return least + most

    @wp.func
    def way(signal: vector, column: vector, low: vector, margin: float, only_less: bool) -> float:
        first = room(signal, column, low, margin)
        if only_less and first >= 0.0:
            return 0.0
        return first + 0.5 * room(signal + first * column, column, low, margin)

    @wp.func
    def spread(columns: columns_type, low: vector, wanted: wp.vec4):
        signal = vector()
        moved = wp.vec4()
        for axis in range(4):
            if wp.static(airmode == 2) or axis != wp.static(YAW):
                signal += wanted[axis] * columns[axis]
        moved[THRUST] = way(signal, columns[THRUST], low, 0.0, wp.static(airmode == 0))
        signal += moved[THRUST] * columns[THRUST]
        if wp.static(airmode == 0):
            for axis in range(2):
                moved[axis] = way(signal, columns[axis], low, 0.0, False)
                signal += moved[axis] * columns[axis]
        margin = 0.0
        if wp.static(airmode != 2):
            signal += wanted[YAW] * columns[YAW]
            margin = wp.static(YAW_MARGIN)
        moved[YAW] = way(signal, columns[YAW], low, margin, False)
        signal += moved[YAW] * columns[YAW]
        if wp.static(airmode != 2):
            signal += way(signal, columns[THRUST], low, 0.0, True) * columns[THRUST]
        return signal, moved

    @wp.func
    def mixer(params: command_type, unit_torque: wp.vec3, unit_thrust: float, torque: wp.vec3, collective: float):
        columns = columns_type()
        low = vector()
        unit = wp.vec4(unit_torque[0], unit_torque[1], unit_torque[2], unit_thrust)
        wanted = wp.vec4(torque[0], torque[1], torque[2], collective)
        for i in range(wp.static(num_rotors)):
            row = params.allocation[i]
            part = wp.vec4(row[3], row[4], row[5], row[2])
            low[i] = params.low[i] / params.high[i]
            for axis in range(4):
                columns[axis, i] = part[axis] * unit[axis] / params.high[i]
        level = wanted[ROLL] * columns[ROLL] + wanted[PITCH] * columns[PITCH] + wanted[THRUST] * columns[THRUST]
        signal = level + wanted[YAW] * columns[YAW]
        inside = bool(True)  # noqa: UP018
        for i in range(wp.static(num_rotors)):
            if wp.min(signal[i], level[i]) < low[i] or wp.max(signal[i], level[i]) > 1.0:
                inside = False
        short = wp.vec3()
        if not inside:
            signal, moved = spread(columns, low, wanted)
            cut = bool(False)  # noqa: UP018
            for i in range(wp.static(num_rotors)):
                if wp.abs(wp.clamp(signal[i], low[i], 1.0) - signal[i]) > NEGLIGIBLE:
                    cut = True
            for axis in range(3):
                lost = wp.where(cut, wanted[axis], -moved[axis])
                if wp.abs(lost) > NEGLIGIBLE:
                    short[axis] = wp.sign(lost)
        thrust = vector()
        for i in range(wp.static(num_rotors)):
            thrust[i] = wp.clamp(signal[i], low[i], 1.0) * params.high[i]
        return thrust, short

    return mixer
