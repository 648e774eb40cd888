"""The Crazyflie's controllers in the fused kernel: Warp versions of ``control.crazyflie.controller``.

The torque signs of the rotors are equal in all environments and are constants of the generated code.
Letters: E environments, R rotors.
"""

from collections.abc import Callable
from math import degrees, tan
from typing import TYPE_CHECKING

import torch
import warp as wp
from torch import Tensor

from aerial_gym.control.cascade_fused import make_stateful_step, make_two_levels
from aerial_gym.control.crazyflie.distribution import MOST_COUNTS, SHARES
from aerial_gym.control.crazyflie.mellinger import MOST_COUNTS as MOST_OF_MELLINGER
from aerial_gym.control.crazyflie.pid import INNER_NUMBERS, LEEWAY, MOST_MOMENT, MOST_THRUST, THRUST_PER_OUTPUT
from aerial_gym.control.lee import LEAST_LIFT
from aerial_gym.control.lee_fused import read_vec3, within_inclination, write_vec3
from aerial_gym.control.timing import Timing
from aerial_gym.math.warp_functions import euler_angles, rotate_inverse, unit
from aerial_gym.physics.fused.command import make_clamp, make_speed_command
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.fused.memory import LawArrays
from aerial_gym.physics.fused.types import rotor_types

if TYPE_CHECKING:
    from aerial_gym.control.stateful import MemoryLayout

Maker = Callable[[FusedLaw, int, bool], wp.Function]


@wp.struct
class MellingerRows:
    """All gains: ``mellinger.MellingerGains``."""

    mass: float  # [kg]
    mass_thrust: float  # [counts/N]
    position: wp.vec3  # [N/m]
    velocity: wp.vec3  # [N s/m]
    position_integral: wp.vec3  # [N/(m s)]
    position_limit: wp.vec3  # [m s]
    attitude: wp.vec3  # [counts]
    rate: wp.vec3  # [counts s/rad]
    attitude_integral: wp.vec3  # [counts/s]
    attitude_limit: wp.vec3  # [s]
    rate_difference: float  # [counts s²/rad]


@wp.struct
class LevelRows:
    """Three PID controllers side by side: ``pid.PidLevel``."""

    proportional: wp.vec3
    integral: wp.vec3
    derivative: wp.vec3
    limit: wp.vec3


@wp.struct
class PidRows:
    """All gains: ``pid.PidGains``."""

    position: LevelRows
    velocity: LevelRows
    attitude: LevelRows
    rates: LevelRows
    most_velocity: wp.vec3  # [m/s]
    most_tilt: float  # [deg]
    thrust_base: float  # [counts]
    least_thrust: float  # [counts]


@wp.func
def limit_vector(vector: wp.vec3, limit: wp.vec3) -> wp.vec3:
    """Clamp a vector to plus and minus a limit."""
    return wp.min(wp.max(vector, -limit), limit)


@wp.func
def run_level(level: LevelRows, error: wp.vec3, change: wp.vec3, integral: wp.vec3, dt: float):
    """Return output and integral of ``pid.PidLevel.run``."""
    grown = limit_vector(integral + dt * error, level.limit)
    output = wp.cw_mul(level.proportional, error) + wp.cw_mul(level.integral, grown)
    return output - wp.cw_mul(level.derivative, change) / dt, grown


@wp.func
def in_heading(vector: wp.vec3, cosine: float, sine: float) -> wp.vec3:
    """Rotate a world vector into the heading frame."""
    return wp.vec3(cosine * vector[0] + sine * vector[1], cosine * vector[1] - sine * vector[0], vector[2])


@wp.func
def wrap_yaw(angles: wp.vec3) -> wp.vec3:
    """Return roll, pitch, yaw [deg] with the yaw wrapped to -180 to 180."""
    return wp.vec3(angles[0], angles[1], angles[2] - 360.0 * wp.floor((angles[2] + 180.0) / 360.0))


def make_motors(num_rotors: int, general: bool, signs: Tensor) -> wp.Function:
    """Return the power distribution, from thrust and moments [counts] to commanded speeds [rad/s]."""
    types = rotor_types(num_rotors, general)
    command_type, vector, turns = types.command, types.vector, types.rows
    limited, speed_of = make_clamp(num_rotors, general), make_speed_command(num_rotors, general)
    shares = turns(*(signs.cpu() * torch.tensor(SHARES, dtype=signs.dtype)).flatten().tolist())

    @wp.func
    def motors(params: command_type, thrust: float, moment: wp.vec3) -> vector:
        counts = wp.static(shares) * moment
        for i in range(wp.static(num_rotors)):
            counts[i] = counts[i] + thrust
        excess = wp.max(wp.max(counts) - wp.static(MOST_COUNTS), 0.0)
        force = vector()
        for i in range(wp.static(num_rotors)):
            force[i] = params.high[i] * wp.max(counts[i] - excess, 0.0) / wp.static(MOST_COUNTS)
        return speed_of(params, limited(params, force))

    return motors


def mellinger_maker(
    timing: Timing, layout: "MemoryLayout", signs: Tensor, *, gravity: float, max_inclination: float
) -> Maker:
    """Return ``FusedLaw.make_stateful_step`` of ``mellinger.mellinger_control``."""
    period, slope = float(timing.loop), tan(max_inclination)

    def make(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
        types = rotor_types(num_rotors, general)
        command_type, vector, motors = types.command, types.vector, make_motors(num_rotors, general, signs)

        @wp.func
        def run(
            params: command_type, gains: MellingerRows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
            ang_vel: wp.vec3, action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
        ) -> vector:  # fmt: skip
            span = wp.static(period) * dt
            error = wp.vec3(action[0], action[1], action[2]) - position
            far = limit_vector(read_vec3(arrays.numbers, 0, env) + span * error, gains.position_limit)
            weight = gains.mass * wp.static(gravity)
            force = wp.cw_mul(gains.position, error) - wp.cw_mul(gains.velocity, lin_vel)
            force += wp.cw_mul(gains.position_integral, far) + wp.vec3(0.0, 0.0, weight)
            force = within_inclination(force, wp.static(LEAST_LIFT) * weight, wp.static(slope))
            seen = rotate_inverse(attitude, force)
            d3 = unit(seen)
            heading = wp.vec3(wp.cos(action[3]), wp.sin(action[3]), 0.0)
            d2 = unit(wp.cross(d3, rotate_inverse(attitude, heading)))
            d1 = wp.cross(d2, d3)
            turn = wp.vec3(d3[1] - d2[2], d1[2] - d3[0], d2[0] - d1[1])
            turned = limit_vector(read_vec3(arrays.numbers, 3, env) - span * turn, gains.attitude_limit)
            moment = wp.cw_mul(gains.attitude_integral, turned) - wp.cw_mul(gains.attitude, turn)
            moment -= wp.cw_mul(gains.rate, ang_vel)
            for i in range(2):
                before = arrays.numbers[6 + i, env]
                if since == 0:
                    before = ang_vel[i]
                moment[i] = moment[i] - gains.rate_difference * (ang_vel[i] - before) / span
                arrays.numbers[6 + i, env] = ang_vel[i]
            most = wp.static(MOST_OF_MELLINGER)
            moment = limit_vector(moment, wp.vec3(most, most, most))
            if seen[2] <= 0.0:
                moment = wp.vec3()
                far = wp.vec3()
                turned = wp.vec3()
            write_vec3(arrays.numbers, 0, env, far)
            write_vec3(arrays.numbers, 3, env, turned)
            return motors(params, gains.mass_thrust * seen[2], moment)

        return make_stateful_step(law, num_rotors, general, timing, layout, run)

    return make


def make_outer_loop(timing: Timing) -> wp.Function:
    """Return the Warp version of ``pid.lean``: from an action to thrust [counts], roll, pitch and yaw [deg]."""
    period = float(timing.law)

    @wp.func
    def outer_loop(
        gains: PidRows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, action: wp.vec4,
        arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        span = wp.static(period) * dt
        yaw = euler_angles(attitude)[2]
        cosine = wp.cos(yaw)
        sine = wp.sin(yaw)
        error = in_heading(wp.vec3(action[0], action[1], action[2]) - position, cosine, sine)
        moving = in_heading(lin_vel, cosine, sine)
        far = read_vec3(arrays.numbers, wp.static(INNER_NUMBERS), env)
        drift = read_vec3(arrays.numbers, wp.static(INNER_NUMBERS + 3), env)
        wanted, far = run_level(gains.position, error, wp.vec3(), far, span)
        wanted = limit_vector(wanted, wp.static(LEEWAY) * gains.most_velocity)
        output, drift = run_level(gains.velocity, wanted - moving, wp.vec3(), drift, span)
        write_vec3(arrays.numbers, wp.static(INNER_NUMBERS), env, far)
        write_vec3(arrays.numbers, wp.static(INNER_NUMBERS + 3), env, drift)
        thrust = wp.min(gains.thrust_base + wp.static(THRUST_PER_OUTPUT) * output[2], wp.static(MOST_THRUST))
        return wp.vec4(
            wp.max(thrust, gains.least_thrust),
            -wp.clamp(output[1], -gains.most_tilt, gains.most_tilt),
            wp.clamp(output[0], -gains.most_tilt, gains.most_tilt),
            wp.static(degrees(1.0)) * action[3],
        )

    return outer_loop


def make_inner_loop(num_rotors: int, general: bool, timing: Timing, signs: Tensor) -> wp.Function:
    """Return the Warp version of ``pid.turn`` with the power distribution."""
    types = rotor_types(num_rotors, general)
    command_type, vector, motors = types.command, types.vector, make_motors(num_rotors, general, signs)
    period = float(timing.loop)

    @wp.func
    def run_loop(
        params: command_type, gains: PidRows, attitude: wp.quat, ang_vel: wp.vec3, setpoint: wp.vec4, arrays: LawArrays,
        env: int, since: int, dt: float,
    ) -> vector:  # fmt: skip
        span = wp.static(period) * dt
        angles = wp.static(degrees(1.0)) * euler_angles(attitude)
        rates = wp.static(degrees(1.0)) * ang_vel
        turned = wp.vec3()
        sped = wp.vec3()
        if since > 0:
            turned = wrap_yaw(angles - read_vec3(arrays.numbers, 6, env))
            sped = rates - read_vec3(arrays.numbers, 9, env)
        error = wrap_yaw(wp.vec3(setpoint[1], setpoint[2], setpoint[3]) - angles)
        wanted, leant = run_level(gains.attitude, error, turned, read_vec3(arrays.numbers, 0, env), span)
        moment, spun = run_level(gains.rates, wanted - rates, sped, read_vec3(arrays.numbers, 3, env), span)
        write_vec3(arrays.numbers, 0, env, leant)
        write_vec3(arrays.numbers, 3, env, spun)
        write_vec3(arrays.numbers, 6, env, angles)
        write_vec3(arrays.numbers, 9, env, rates)
        most = wp.static(MOST_MOMENT)
        return motors(params, setpoint[0], limit_vector(moment, wp.vec3(most, most, most)))

    return run_loop


def pid_maker(timing: Timing, layout: "MemoryLayout", signs: Tensor) -> Maker:
    """Return ``FusedLaw.make_stateful_step`` of the PID cascade."""

    def make(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
        run_loop = make_inner_loop(num_rotors, general, timing, signs)
        run = make_two_levels(law, num_rotors, general, timing, make_outer_loop(timing), run_loop)
        return make_stateful_step(law, num_rotors, general, timing, layout, run)

    return make
