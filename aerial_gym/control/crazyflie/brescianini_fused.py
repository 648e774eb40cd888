"""The Crazyflie's Brescianini controller in the fused kernel: the Warp version of ``brescianini``.

Letters: E environments, R rotors.
"""

from math import tan
from typing import TYPE_CHECKING

import warp as wp

from aerial_gym.control.cascade_fused import make_allot, make_stateful_step, make_two_levels
from aerial_gym.control.crazyflie.crazyflie_fused import Maker
from aerial_gym.control.lee import LEAST_LIFT
from aerial_gym.control.lee_fused import within_inclination
from aerial_gym.control.reduced_attitude_fused import shortest_turn, tilt_first_error
from aerial_gym.control.timing import Timing
from aerial_gym.math.warp_functions import unit, world_up
from aerial_gym.physics.fused.command import make_speed_command
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.fused.memory import LawArrays
from aerial_gym.physics.fused.types import rotor_types

if TYPE_CHECKING:
    from aerial_gym.control.stateful import MemoryLayout


@wp.struct
class BrescianiniRows:
    """All gains: ``brescianini.BrescianiniGains``."""

    mass: float  # [kg]
    inertia: wp.mat33  # [kg m²]
    position: wp.vec3  # [1/s²]
    velocity: wp.vec3  # [1/s]
    attitude: float  # [1/s]
    mixing: float  # [-]
    rate: wp.vec3  # [1/s]
    least_thrust: float  # [m/s²]
    most_thrust: float  # [m/s²]
    tilt_rate_limit: float  # [rad/s]
    yaw_rate_limit: float  # [rad/s]


def make_outer_loop(*, gravity: float, max_inclination: float) -> wp.Function:
    """Return the Warp version of ``brescianini.lean`` for a point at rest: thrust [N] and body rates [rad/s]."""
    slope = tan(max_inclination)

    @wp.func
    def outer_loop(
        gains: BrescianiniRows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        error = wp.vec3(action[0], action[1], action[2]) - position
        wanted = wp.cw_mul(gains.position, error) - wp.cw_mul(gains.velocity, lin_vel)
        wanted += wp.vec3(0.0, 0.0, wp.static(gravity))
        wanted = within_inclination(wanted, wp.static(LEAST_LIFT * gravity), wp.static(slope))
        collective = wp.clamp(wanted[2] / world_up(attitude)[2], gains.least_thrust, gains.most_thrust)
        turn = shortest_turn(wp.vec3(0.0, 0.0, 1.0), unit(wanted))
        goal = turn * wp.quat(0.0, 0.0, wp.sin(0.5 * action[3]), wp.cos(0.5 * action[3]))
        rates = 2.0 * gains.attitude * tilt_first_error(attitude, goal, gains.mixing)
        size = wp.sqrt(rates[0] * rates[0] + rates[1] * rates[1])
        share = gains.tilt_rate_limit / wp.max(size, gains.tilt_rate_limit)
        return wp.vec4(
            gains.mass * collective,
            share * rates[0],
            share * rates[1],
            wp.clamp(rates[2], -gains.yaw_rate_limit, gains.yaw_rate_limit),
        )

    return outer_loop


def make_inner_loop(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
    """Return the Warp version of ``brescianini.turn`` with the allocation."""
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector
    allot, speed_of = make_allot(law, num_rotors, general), make_speed_command(num_rotors, general)

    @wp.func
    def run_loop(
        params: command_type, gains: BrescianiniRows, attitude: wp.quat, ang_vel: wp.vec3, setpoint: wp.vec4,
        arrays: LawArrays, env: int, since: int, dt: float,
    ) -> vector:  # fmt: skip
        error = wp.vec3(setpoint[1], setpoint[2], setpoint[3]) - ang_vel
        torque = gains.inertia * wp.cw_mul(gains.rate, error)
        thrust, _turn, _rest = allot(params, wp.spatial_vector(0.0, 0.0, setpoint[0], torque[0], torque[1], torque[2]))
        return speed_of(params, thrust)

    return run_loop


def brescianini_maker(timing: Timing, layout: "MemoryLayout", *, gravity: float, max_inclination: float) -> Maker:
    """Return ``FusedLaw.make_stateful_step`` of the controller."""

    def make(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
        wish = make_outer_loop(gravity=gravity, max_inclination=max_inclination)
        run = make_two_levels(law, num_rotors, general, timing, wish, make_inner_loop(law, num_rotors, general))
        return make_stateful_step(law, num_rotors, general, timing, layout, run)

    return make
