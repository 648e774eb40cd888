"""PX4's cascade in the fused kernel: the Warp version of ``control.px4.controller``.

Its memory is in device memory with the offsets of ``controller``. Filters are equal in all environments and are constants of
the generated code.
Frames: world z up, body x forward, y left, z up. Letters: E environments, R rotors.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import warp as wp

from aerial_gym.control.cascade_fused import make_allot, make_stateful_step, make_two_levels
from aerial_gym.control.filters.biquad_fused import make_filter
from aerial_gym.control.lee_fused import from_vehicle_frame, inverse_cos_pitch, read_vec3, write_vec3
from aerial_gym.control.px4.mixer import make_mixer
from aerial_gym.control.px4.rates import FADING_RATE, RATE_NUMBERS
from aerial_gym.control.reduced_attitude_fused import tilt_first_error
from aerial_gym.control.timing import Timing
from aerial_gym.math.warp_functions import world_up
from aerial_gym.physics.fused.command import make_speed_command
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.fused.memory import LawArrays
from aerial_gym.physics.fused.types import rotor_types

if TYPE_CHECKING:
    from aerial_gym.control.px4.parameters import Px4Filters
    from aerial_gym.control.stateful import MemoryLayout


@wp.struct
class Px4Rows:
    """All parameters: ``parameters.Px4Gains``."""

    rate: wp.vec3  # [s/rad]
    rate_integral: wp.vec3  # [1/rad]
    rate_derivative: wp.vec3  # [s²/rad]
    rate_forward: wp.vec3  # [s/rad]
    integral_limit: wp.vec3  # [-]
    attitude: wp.vec3  # [1/s]
    rate_limit: wp.vec3  # [rad/s]
    unit_torque: wp.vec3  # [N m]
    position: wp.vec3  # [1/s]
    velocity: wp.vec3  # [1/s]
    integral: wp.vec3  # [1/s²]
    derivative: wp.vec3  # [-]
    unit_thrust: float  # [N]
    yaw_weight: float  # [-]
    speed: float  # [m/s]
    up: float  # [m/s]
    down: float  # [m/s]
    least_thrust: float  # [-]
    most_thrust: float  # [-]
    margin: float  # [-]
    tilt: float  # [rad]
    hover: float  # [-]
    gravity: float  # [m/s²]


@wp.func
def limit_length(vector: wp.vec2, most: float) -> wp.vec2:
    """Limit a vector to a length."""
    length = wp.length(vector)
    shortened = vector
    if length > most:
        shortened = vector / length * most
    return shortened


@wp.func
def rate_setpoint(gains: Px4Rows, attitude: wp.quat, wanted: wp.quat, yaw_rate: float) -> wp.vec3:
    """Return the Warp version of ``attitude.rate_setpoint`` [rad/s], body."""
    error = tilt_first_error(attitude, wanted, gains.yaw_weight)
    gain = wp.vec3(gains.attitude[0], gains.attitude[1], gains.attitude[2] / gains.yaw_weight)
    rates = 2.0 * wp.cw_mul(gain, error) + yaw_rate * world_up(attitude)
    return wp.min(wp.max(rates, -gains.rate_limit), gains.rate_limit)


@wp.func
def attitude_from_thrust(thrust: wp.vec3, cosine: float, sine: float) -> wp.quat:
    """Return the Warp version of ``attitude.attitude_from_thrust``, from cosine and sine of the yaw."""
    b3 = wp.normalize(thrust)
    b1 = wp.normalize(wp.cross(wp.vec3(-sine, cosine, 0.0), b3))
    return wp.normalize(wp.quat_from_matrix(wp.matrix_from_cols(b1, wp.cross(b3, b1), b3)))


@wp.func
def thrust_setpoint(acceleration: wp.vec3, gains: Px4Rows) -> wp.vec3:
    """Return the Warp version of ``position.thrust_setpoint`` [-], world."""
    axis = wp.normalize(wp.vec3(acceleration[0], acceleration[1], gains.gravity))
    flat = wp.sqrt(axis[0] * axis[0] + axis[1] * axis[1])
    if flat > wp.sin(gains.tilt):
        shorter = wp.sin(gains.tilt) / flat
        axis = wp.vec3(shorter * axis[0], shorter * axis[1], wp.cos(gains.tilt))
    collective = (acceleration[2] / gains.gravity + 1.0) * gains.hover / axis[2]
    return wp.max(collective, gains.least_thrust) * axis


def make_thrust(alpha: float, span_steps: int, first: int) -> wp.Function:
    """Return the Warp version of ``controller.Px4Controller._thrust``; its memory starts at ``first``."""

    @wp.func
    def velocity_thrust(
        gains: Px4Rows, wanted: wp.vec3, lin_vel: wp.vec3, arrays: LawArrays, env: int, since: int, dt: float
    ) -> wp.vec3:
        span = wp.static(float(span_steps)) * dt
        integral = read_vec3(arrays.numbers, wp.static(first), env)
        smooth = read_vec3(arrays.numbers, wp.static(first + 6), env)
        measured = wp.vec3()
        if since > 0:
            measured = (lin_vel - read_vec3(arrays.numbers, wp.static(first + 3), env)) / span
        smooth += wp.static(alpha) * (measured - smooth)
        flat = limit_length(wp.vec2(wanted[0], wanted[1]), gains.speed)
        error = wp.vec3(flat[0], flat[1], wp.clamp(wanted[2], -gains.down, gains.up)) - lin_vel
        acceleration = wp.cw_mul(error, gains.velocity) + integral - wp.cw_mul(smooth, gains.derivative)
        asked = thrust_setpoint(acceleration, gains)
        rise = error[2]
        if (asked[2] <= gains.least_thrust and rise <= 0.0) or (asked[2] >= gains.most_thrust and rise >= 0.0):
            rise = 0.0
        lateral = wp.vec2(asked[0], asked[1])
        most = gains.most_thrust * gains.most_thrust
        kept = wp.min(wp.length(lateral), gains.margin)
        up = wp.min(asked[2], wp.sqrt(most - kept * kept))
        lateral = limit_length(lateral, wp.sqrt(wp.max(most - up * up, 0.0)))
        made = lateral * (gains.gravity / gains.hover)
        meant = wp.vec2(acceleration[0], acceleration[1])
        drift = wp.vec2(error[0], error[1])
        if wp.length_sq(meant) > wp.length_sq(made):
            drift -= 2.0 / gains.velocity[0] * (meant - made)
        integral += wp.cw_mul(wp.vec3(drift[0], drift[1], rise), gains.integral) * span
        integral[2] = wp.clamp(integral[2], -gains.gravity, gains.gravity)
        write_vec3(arrays.numbers, wp.static(first), env, integral)
        write_vec3(arrays.numbers, wp.static(first + 3), env, lin_vel)
        write_vec3(arrays.numbers, wp.static(first + 6), env, smooth)
        return wp.vec3(lateral[0], lateral[1], up)

    return velocity_thrust


def make_setpoint(law: str, filters: "Px4Filters", timing: Timing, first: int) -> wp.Function:
    """Return the Warp version of ``controller.Px4Controller._outer``: from an action to thrust [-] and body rates [rad/s]."""
    thrust_for = make_thrust(filters.acceleration, timing.law, first)

    @wp.func
    def position(
        gains: Px4Rows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        wanted = wp.cw_mul(gains.position, wp.vec3(action[0], action[1], action[2]) - position)
        thrust = thrust_for(gains, wanted, lin_vel, arrays, env, since, dt)
        goal = attitude_from_thrust(thrust, wp.cos(action[3]), wp.sin(action[3]))
        rates = rate_setpoint(gains, attitude, goal, 0.0)
        return wp.vec4(wp.length(thrust), rates[0], rates[1], rates[2])

    @wp.func
    def velocity(
        gains: Px4Rows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        up = world_up(attitude)
        inverse = inverse_cos_pitch(up)
        forward = from_vehicle_frame(attitude, inverse, wp.vec3(1.0, 0.0, 0.0))
        wanted = from_vehicle_frame(attitude, inverse, wp.vec3(action[0], action[1], action[2]))
        thrust = thrust_for(gains, wanted, lin_vel, arrays, env, since, dt)
        rates = rate_setpoint(gains, attitude, attitude_from_thrust(thrust, forward[0], forward[1]), action[3])
        return wp.vec4(wp.length(thrust), rates[0], rates[1], rates[2])

    @wp.func
    def attitude(
        gains: Px4Rows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        forward = from_vehicle_frame(attitude, inverse_cos_pitch(world_up(attitude)), wp.vec3(1.0, 0.0, 0.0))
        yaw = wp.atan2(forward[1], forward[0])
        turn = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), yaw)
        pitched = turn * wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), action[2])
        goal = pitched * wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), action[1])
        rates = rate_setpoint(gains, attitude, goal, action[3])
        return wp.vec4((action[0] + 1.0) * gains.hover, rates[0], rates[1], rates[2])

    @wp.func
    def rates(
        gains: Px4Rows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        return wp.vec4((action[0] + 1.0) * gains.hover, action[1], action[2], action[3])

    return {"position": position, "velocity": velocity, "attitude": attitude, "rates": rates}[law]


def make_gyro(filters: "Px4Filters", after: int) -> wp.Function:
    """Return the filters of body rates; the low-pass has its memory from number 9 on, the notches from ``after`` on."""
    notches = (*filters.notches, None, None)
    first, second = (make_filter(notches[k], after + 6 * k) for k in range(2))
    low_pass = make_filter(filters.gyro, 9)

    @wp.func
    def gyro(ang_vel: wp.vec3, arrays: LawArrays, env: int, since: int) -> wp.vec3:
        return low_pass(second(first(ang_vel, arrays, env, since), arrays, env, since), arrays, env, since)

    return gyro


def make_rates(
    law: FusedLaw, num_rotors: int, general: bool, filters: "Px4Filters", timing: Timing, factor: float | None,
    airmode: int | None,
) -> wp.Function:  # fmt: skip
    """Return the Warp version of ``controller.Px4Controller._rates``."""
    types = rotor_types(num_rotors, general)
    command_type, vector, period = types.command, types.vector, float(timing.loop)
    mixed, gyro = make_mix(law, num_rotors, general, airmode), make_gyro(filters, RATE_NUMBERS)
    speed_of = make_motors(num_rotors, general, factor)
    ang_acc_share, yaw_share, fading = filters.ang_acc, filters.yaw_torque, FADING_RATE

    @wp.func
    def run_loop(
        params: command_type, gains: Px4Rows, attitude: wp.quat, ang_vel: wp.vec3, setpoint: wp.vec4, arrays: LawArrays,
        env: int, since: int, dt: float,
    ) -> vector:  # fmt: skip
        span = wp.static(period) * dt
        integral = read_vec3(arrays.numbers, 0, env)
        ang_acc = read_vec3(arrays.numbers, 3, env)
        short = read_vec3(arrays.numbers, 15, env)
        rate = gyro(ang_vel, arrays, env, since)
        measured = wp.vec3()
        if since > 0:
            measured = (rate - read_vec3(arrays.numbers, 6, env)) / span
        ang_acc += wp.static(ang_acc_share) * (measured - ang_acc)
        wanted = wp.vec3(setpoint[1], setpoint[2], setpoint[3])
        error = wanted - rate
        torque = wp.cw_mul(gains.rate, error) + integral - wp.cw_mul(gains.rate_derivative, ang_acc)
        torque += wp.cw_mul(gains.rate_forward, wanted)
        yaw = arrays.numbers[18, env]
        torque[2] = yaw + wp.static(yaw_share) * (torque[2] - yaw)
        thrust, missing = mixed(params, gains.unit_torque, gains.unit_thrust, torque, setpoint[0])
        for i in range(3):
            useful = wp.where(short[i] * error[i] > 0.0, 0.0, error[i])
            share = useful / wp.static(fading)
            growth = wp.max(1.0 - share * share, 0.0) * gains.rate_integral[i] * useful * span
            limit = gains.integral_limit[i]
            arrays.numbers[i, env] = wp.min(wp.max(integral[i] + growth, -limit), limit)
            arrays.numbers[15 + i, env] = missing[i]
        write_vec3(arrays.numbers, 3, env, ang_acc)
        write_vec3(arrays.numbers, 6, env, rate)
        arrays.numbers[18, env] = torque[2]
        return speed_of(params, thrust)

    return run_loop


def make_mix(law: FusedLaw, num_rotors: int, general: bool, airmode: int | None) -> wp.Function:
    """Return the Warp version of ``controller.Px4Controller._mixed``."""
    if airmode is not None:
        return make_mixer(num_rotors, general, airmode)
    command_type, allot = rotor_types(num_rotors, general).command, make_allot(law, num_rotors, general)

    @wp.func
    def allocate_wrench(
        params: command_type, unit_torque: wp.vec3, unit_thrust: float, torque: wp.vec3, collective: float
    ):
        turning = wp.cw_mul(torque, unit_torque)
        thrust, turn, rest = allot(
            params, wp.spatial_vector(0.0, 0.0, collective * unit_thrust, turning[0], turning[1], turning[2])
        )
        given = wp.vec3(turn, turn, rest)
        short = wp.vec3()
        for i in range(3):
            if given[i] < 1.0 and torque[i] != 0.0:
                short[i] = wp.sign(torque[i])
        return thrust, short

    return allocate_wrench


def make_motors(num_rotors: int, general: bool, factor: float | None) -> wp.Function:
    """Return the Warp version of ``controller.Px4Controller._speeds``."""
    types = rotor_types(num_rotors, general)
    command_type, vector, known = types.command, types.vector, make_speed_command(num_rotors, general)
    if factor is None:
        return known
    linear, middle, part = factor == 0.0, (1.0 - factor) / (2.0 * max(factor, 1e-6)), 1.0 / max(factor, 1e-6)

    @wp.func
    def model_speed(params: command_type, thrust: vector) -> vector:
        low = known(params, params.low)
        high = known(params, params.high)
        speed = vector()
        for i in range(wp.static(num_rotors)):
            signal = wp.clamp(thrust[i] / params.high[i], 0.0, 1.0)
            if wp.static(not linear):
                signal = wp.sqrt(wp.static(middle * middle) + wp.static(part) * signal) - wp.static(middle)
            speed[i] = low[i] + (high[i] - low[i]) * signal
        return speed

    return model_speed


def maker(
    law_name: str,
    filters: "Px4Filters",
    timing: Timing,
    layout: "MemoryLayout",
    *,
    first: int,
    factor: float | None,
    airmode: int | None,
) -> Callable[[FusedLaw, int, bool], wp.Function]:
    """Return ``FusedLaw.make_stateful_step`` of the cascade.

    Args:
        law_name: One of ``controllers.OF_PX4``.
        layout: Offsets into the memory.
        first: Offset of the law's own memory.
    """

    def make(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
        wish = make_setpoint(law_name, filters, timing, first)
        run_loop = make_rates(law, num_rotors, general, filters, timing, factor, airmode)
        run = make_two_levels(law, num_rotors, general, timing, wish, run_loop)
        return make_stateful_step(law, num_rotors, general, timing, layout, run)

    return make
