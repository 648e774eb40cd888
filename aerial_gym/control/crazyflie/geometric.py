"""Lee's geometric law in the Crazyflie's version, with integrals of position and attitude error.

Frames: world z up, body x forward, y left, z up. Letters: E environments.
Source: Lee, Leok, McClamroch (2010), Geometric tracking control of a quadrotor UAV on SE(3), and for the integrals Goodarzi,
Lee, Leok (2013), Geometric nonlinear PID control of a quadrotor UAV on SE(3). The Crazyflie integrates only the errors of
position and attitude, as its outputs show (``tests/cross/firmware``).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.control.crazyflie.mellinger import FlatTarget
from aerial_gym.control.lee import (
    LeeGains,
    attitude_error,
    attitude_from_force,
    attitude_torque,
    force_within_inclination,
    heading_of_yaw,
)
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics.state import BodyState

WIDTH = 6  # Remembered numbers: integrals of position (3) and attitude (3)


@dataclass(frozen=True, kw_only=True)
class IntegralGains:
    """Gains of every environment."""

    lee: LeeGains  # Of the law without integrals
    position_integral: Tensor  # `Kpos_I` [1/s³], (E, 3)
    position_limit: Tensor  # `Kpos_I_limit` [m s], (E, 3)
    attitude_integral: Tensor  # `KI` [N m/(rad s)], (E, 3)
    attitude_limit: Tensor  # `KI_limit` [rad s], (E, 3)


def geometric_control(
    state: BodyState, target: FlatTarget, kept: Tensor, gains: IntegralGains, *, dt: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return thrust [N], (E,), torque [N m], body, (E, 3), and the new memory, (E, 6).

    ``a = K_p e_p + K_v e_v + K_i int e_p + a_d`` and ``F = m (a - g)``; the thrust is its component along body z. The torque is
    ``-K_R e_R - K_w e_w - K_I int e_R + w x J w``.

    Args:
        target: Target without its body rates.
        kept: Memory of the previous run, (E, 6); zeros after a reset.
    """
    far, turned = kept.split(3, dim=-1)
    lee = gains.lee
    error, drift = target.position - state.position, target.velocity - state.lin_vel
    far = (far + error * dt).clamp(-gains.position_limit, gains.position_limit)
    wanted = lee.position * error + lee.velocity * drift + gains.position_integral * far + target.acceleration
    force = force_within_inclination(wanted, lee)
    along = quat_rotate_inverse(state.attitude, force)
    turn = attitude_from_force(along, heading_of_yaw(state.attitude, target.yaw))
    turned = (turned + attitude_error(turn) * dt).clamp(-gains.attitude_limit, gains.attitude_limit)
    torque = attitude_torque(lee, turn, state.ang_vel, torch.zeros_like(state.ang_vel))
    torque = torque - gains.attitude_integral * turned
    return along[:, 2], torque, torch.cat((far, turned), dim=-1)
