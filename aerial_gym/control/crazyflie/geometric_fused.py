"""The Crazyflie's Lee controller in the fused kernel: the Warp version of ``geometric``.

Letters: E environments, R rotors.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import warp as wp
from torch import Tensor

from aerial_gym.control.cascade_fused import make_allot, make_stateful_step
from aerial_gym.control.crazyflie.crazyflie_fused import Maker, limit_vector
from aerial_gym.control.lee_fused import (
    LeeParams,
    attitude_torque,
    gain_rows,
    limit_force,
    rate_torque,
    read_vec3,
    write_vec3,
)
from aerial_gym.control.timing import Timing
from aerial_gym.math.warp_functions import rotate_inverse, unit
from aerial_gym.physics.fused.command import make_speed_command
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.fused.memory import LawArrays
from aerial_gym.physics.fused.types import rotor_types

if TYPE_CHECKING:
    from aerial_gym.control.crazyflie.geometric import IntegralGains
    from aerial_gym.control.stateful import MemoryLayout

INTEGRALS = ("position_integral", "position_limit", "attitude_integral", "attitude_limit")


@wp.struct
class IntegralRows:
    """All gains: ``geometric.IntegralGains``."""

    lee: LeeParams
    position_integral: wp.vec3  # [1/s³]
    position_limit: wp.vec3  # [m s]
    attitude_integral: wp.vec3  # [N m/(rad s)]
    attitude_limit: wp.vec3  # [rad s]


def integral_rows(gains: "IntegralGains") -> Mapping[str, Tensor]:
    """Return the fields of ``IntegralRows`` in their order, each (E, ...)."""
    return {
        **{f"lee.{name}": rows for name, rows in gain_rows(gains.lee).items()},
        **{name: getattr(gains, name) for name in INTEGRALS},
    }


def geometric_maker(timing: Timing, layout: "MemoryLayout") -> Maker:
    """Return ``FusedLaw.make_stateful_step`` of the controller."""
    period = float(timing.loop)

    def make(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
        types = rotor_types(num_rotors, general)
        command_type, vector = types.command, types.vector
        allot, speed_of = make_allot(law, num_rotors, general), make_speed_command(num_rotors, general)

        @wp.func
        def run(
            params: command_type, gains: IntegralRows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
            ang_vel: wp.vec3, action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
        ) -> vector:  # fmt: skip
            span = wp.static(period) * dt
            lee = gains.lee
            error = wp.vec3(action[0], action[1], action[2]) - position
            far = limit_vector(read_vec3(arrays.numbers, 0, env) + span * error, gains.position_limit)
            wanted = wp.cw_mul(lee.position, error) - wp.cw_mul(lee.velocity, lin_vel)
            seen = rotate_inverse(attitude, limit_force(lee, wanted + wp.cw_mul(gains.position_integral, far)))
            heading = wp.vec3(wp.cos(action[3]), wp.sin(action[3]), 0.0)
            d3 = unit(seen)
            d2 = unit(wp.cross(d3, rotate_inverse(attitude, heading)))
            d1 = wp.cross(d2, d3)
            turn = 0.5 * wp.vec3(d3[1] - d2[2], d1[2] - d3[0], d2[0] - d1[1])
            turned = limit_vector(read_vec3(arrays.numbers, 3, env) + span * turn, gains.attitude_limit)
            torque = rate_torque(lee, ang_vel, wp.vec3()) + attitude_torque(lee, d1, d2, d3)
            torque -= wp.cw_mul(gains.attitude_integral, turned)
            write_vec3(arrays.numbers, 0, env, far)
            write_vec3(arrays.numbers, 3, env, turned)
            thrust, _turn, _rest = allot(params, wp.spatial_vector(0.0, 0.0, seen[2], torque[0], torque[1], torque[2]))
            return speed_of(params, thrust)

        return make_stateful_step(law, num_rotors, general, timing, layout, run)

    return make
