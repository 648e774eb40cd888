"""PX4's mixer: from normalised torque and thrust to motor signals, with sequential desaturation.

Commands are reduced one after the other along their columns of the mixing matrix: thrust, roll, pitch, yaw. Thrust may rise
to keep roll and pitch with airmode 1, also to keep yaw with airmode 2, and never with airmode 0. The reduction along a column
is exactly the unallocated part of its command.
Frames: body is x forward, y left, z up; PX4's opposite y and z flip two columns and their commands alike.
Letters: E environments, R rotors.

Source: PX4 Autopilot 1.14, ``ControlAllocationSequentialDesaturation``.
"""

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from aerial_gym.physics.fused.allocation import NEGLIGIBLE
from aerial_gym.physics.fused.types import rotor_types

ROLL, PITCH, YAW, THRUST = range(4)
"""Columns of the mixing matrix."""

WEAK = 0.2
"""Normalised coefficient of a motor in a command below which the command does not desaturate that motor."""

YAW_MARGIN = 0.15
"""Excess over the upper limit, as a share of the motor's range, up to which yaw is kept and thrust reduced instead."""


class MixerOutput(NamedTuple):
    """Motor signals, and the signs of unallocated torque."""

    signal: Tensor  # Share of the full thrust, (E, R)
    short: Tensor  # Sign of the unallocated torque about each axis, (E, 3); 0 if all is allocated


def mix(columns: Tensor, wanted: Tensor, low: Tensor, *, airmode: int) -> MixerOutput:
    """Compute the motor signals of PX4's sequential desaturation.

    A motor that still exceeds a limit is clamped, and then no torque counts as allocated.

    Args:
        columns: Mixing matrix, normalised as ``parameters.unit_wrench``, (E, R, 4).
        wanted: Normalised roll, pitch and yaw torque and thrust, (E, 4).
        low: Lowest signals, (E, R); the highest are 1.
        airmode: MC_AIRMODE: 0, 1 or 2.
    """
    given, high = wanted.clone(), torch.ones_like(low)

    def make_room(signal: Tensor, axis: int, top: Tensor, *, only_less: bool = False) -> Tensor:
        column = columns[..., axis]
        first = _desaturation_gain(signal, column, low, top)
        if only_less:
            first = torch.where(first > 0.0, 0.0, first)
        moved = signal + first * column
        second = 0.5 * _desaturation_gain(moved, column, low, top)
        if only_less:
            second = torch.where(first == 0.0, 0.0, second)
        given[:, axis : axis + 1] += first + second
        return moved + second * column

    yaw, first = columns[..., YAW] * wanted[:, YAW : YAW + 1], [ROLL, PITCH, THRUST]
    signal = (columns[..., first] * wanted[:, None, first]).sum(-1)
    if airmode == 2:
        signal = make_room(make_room(signal + yaw, THRUST, high), YAW, high)
    else:
        signal = make_room(signal, THRUST, high, only_less=airmode == 0)
        if airmode == 0:
            signal = make_room(make_room(signal, ROLL, high), PITCH, high)
        signal = make_room(signal + yaw, YAW, high + YAW_MARGIN * (high - low))
        signal = make_room(signal, THRUST, high, only_less=True)
    cut = torch.minimum(torch.maximum(signal, low), high)
    within = ((cut - signal).abs() <= NEGLIGIBLE).all(-1, keepdim=True)
    lost = torch.where(within, wanted - given, wanted)[:, :3]
    return MixerOutput(cut, torch.where(lost.abs() > NEGLIGIBLE, lost.sign(), 0.0))


def _desaturation_gain(signal: Tensor, column: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return PX4's desaturation gain (E, 1): the multiple of ``column`` that removes the limit violation, or balances two."""
    beyond = torch.minimum(torch.maximum(signal, low), high) - signal
    strong = column.abs() >= WEAK
    steps = torch.where(strong, beyond / torch.where(strong, column, 1.0), 0.0)
    return steps.amin(-1, keepdim=True).clamp_max(0.0) + steps.amax(-1, keepdim=True).clamp_min(0.0)


def make_mixer(num_rotors: int, general: bool, airmode: int) -> wp.Function:
    """Return the Warp version of ``mix``, from units of torque [N m] and thrust [N] and normalised commands to thrusts [N].

    Args:
        general: Whether to support every kind of rotor.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector
    columns_type = wp.types.matrix(shape=(4, num_rotors), dtype=wp.float32)

    @wp.func
    def desaturation_gain(signal: vector, column: vector, low: vector, margin: float) -> float:
        least = wp.float32(0.0)
        most = wp.float32(0.0)
        for i in range(wp.static(num_rotors)):
            beyond = wp.clamp(signal[i], low[i], 1.0 + margin * (1.0 - low[i])) - signal[i]
            if wp.abs(column[i]) >= wp.static(WEAK):
                least = wp.min(least, beyond / column[i])
                most = wp.max(most, beyond / column[i])
        return least + most

    @wp.func
    def desaturation_step(signal: vector, column: vector, low: vector, margin: float, only_less: bool) -> float:
        first = desaturation_gain(signal, column, low, margin)
        if only_less and first >= 0.0:
            return 0.0
        return first + 0.5 * desaturation_gain(signal + first * column, column, low, margin)

    @wp.func
    def desaturate(columns: columns_type, low: vector, wanted: wp.vec4):
        signal = vector()
        moved = wp.vec4()
        for axis in range(4):
            if wp.static(airmode == 2) or axis != wp.static(YAW):
                signal += wanted[axis] * columns[axis]
        moved[THRUST] = desaturation_step(signal, columns[THRUST], low, 0.0, wp.static(airmode == 0))
        signal += moved[THRUST] * columns[THRUST]
        if wp.static(airmode == 0):
            for axis in range(2):
                moved[axis] = desaturation_step(signal, columns[axis], low, 0.0, False)
                signal += moved[axis] * columns[axis]
        margin = 0.0
        if wp.static(airmode != 2):
            signal += wanted[YAW] * columns[YAW]
            margin = wp.static(YAW_MARGIN)
        moved[YAW] = desaturation_step(signal, columns[YAW], low, margin, False)
        signal += moved[YAW] * columns[YAW]
        if wp.static(airmode != 2):
            signal += desaturation_step(signal, columns[THRUST], low, 0.0, True) * columns[THRUST]
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
            signal, moved = desaturate(columns, low, wanted)
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
