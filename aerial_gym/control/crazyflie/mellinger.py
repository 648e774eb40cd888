"""The controller of Mellinger and Kumar in the Crazyflie's version: with integrals, a rate difference, and PWM counts.

Frames: world z up, body x forward, y left, z up. Letters: E environments.
Source: Mellinger, Kumar (2011), Minimum snap trajectory generation and control for quadrotors, ICRA, section IV; the
Crazyflie's additions (integrals, rate difference), units, gains and rate of 500 Hz follow its documentation.
"""

from dataclasses import dataclass
from math import tan

import torch
from torch import Tensor

from aerial_gym.control.lee import LEAST_LIFT, attitude_error, attitude_from_force, heading_of_yaw, limit_inclination
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics.state import BodyState

MOST_COUNTS = 32000.0  # Largest moment about any axis [counts]
WIDTH = 8  # Remembered numbers: integrals of position (3) and attitude (3), previous rate errors of roll and pitch (2)


@dataclass(frozen=True, kw_only=True)
class MellingerGains:
    """Gains of every environment, by the parameters of the Crazyflie; vectors are about x, y, z."""

    mass: Tensor  # [kg], (E, 1)
    mass_thrust: Tensor  # `massThrust`: counts per newton, (E, 1)
    position: Tensor  # `kp_xy`, `kp_z` [N/m], (E, 3)
    velocity: Tensor  # `kd_xy`, `kd_z` [N s/m], (E, 3)
    position_integral: Tensor  # `ki_xy`, `ki_z` [N/(m s)], (E, 3)
    position_limit: Tensor  # `i_range_xy`, `i_range_z` [m s], (E, 3)
    attitude: Tensor  # `kR_xy`, `kR_z` [counts], (E, 3)
    rate: Tensor  # `kw_xy`, `kw_z` [counts s/rad], (E, 3)
    attitude_integral: Tensor  # `ki_m_xy`, `ki_m_z` [counts/s], (E, 3)
    attitude_limit: Tensor  # `i_range_m_xy`, `i_range_m_z` [s], (E, 3)
    rate_difference: Tensor  # `kd_omega_rp` [counts s²/rad], of roll and pitch, (E, 1)


@dataclass(frozen=True, kw_only=True)
class FlatTarget:
    """Target of a flat trajectory: position with derivatives, yaw and body rates."""

    position: Tensor  # World [m], (E, 3)
    velocity: Tensor  # World [m/s], (E, 3)
    acceleration: Tensor  # World [m/s²], (E, 3)
    yaw: Tensor  # [rad], (E,)
    rates: Tensor  # Body [rad/s], (E, 3)


def mellinger_control(
    state: BodyState, target: FlatTarget, kept: Tensor, gains: MellingerGains, *, gravity: float, dt: float,
    max_inclination: float | None = None,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    """Return thrust [counts], (E, 1), moment [counts], body, (E, 3), and the new memory, (E, 8).

    ``F = K_p e_p + K_v e_v + K_i int e_p + m (g + a)``; the thrust is its component along body z. The moment
    is ``-K_R e_R - K_w e_w`` with ``e_R = vee(Rd^T R - R^T Rd)``, twice that of the paper, plus the integral of ``-e_R`` and
    the difference of ``e_w``. Without thrust the moment is 0 and the integrals restart.

    Args:
        kept: Memory of the previous run, (E, 8); zeros after a reset.
        max_inclination: Largest tilt of F [rad], whose vertical part is then at least a tenth of the weight; None: as in
            the Crazyflie, which turns over for a target far below.
    """
    far, turned, before = kept.split((3, 3, 2), dim=-1)
    error, drift = target.position - state.position, target.velocity - state.lin_vel
    far = (far + error * dt).clamp(-gains.position_limit, gains.position_limit)
    weight = target.acceleration + target.acceleration.new_tensor((0.0, 0.0, gravity))
    force = gains.position * error + gains.velocity * drift + gains.position_integral * far + gains.mass * weight
    if max_inclination is not None:
        force = limit_inclination(force, LEAST_LIFT * gravity * gains.mass[:, 0], tan(max_inclination))
    along = quat_rotate_inverse(state.attitude, force)
    thrust = along[:, 2:]
    turn = 2.0 * attitude_error(attitude_from_force(along, heading_of_yaw(state.attitude, target.yaw)))
    turned = (turned - turn * dt).clamp(-gains.attitude_limit, gains.attitude_limit)
    excess = state.ang_vel - target.rates
    moment = gains.attitude_integral * turned - gains.attitude * turn - gains.rate * excess
    change = -gains.rate_difference * (excess[:, :2] - before) / dt
    moment = moment + torch.cat((change, torch.zeros_like(change[:, :1])), dim=-1)
    lifts = thrust > 0.0
    moment = torch.where(lifts, moment.clamp(-MOST_COUNTS, MOST_COUNTS), 0.0)
    integrals = torch.where(lifts, torch.cat((far, turned), dim=-1), 0.0)
    return gains.mass_thrust * thrust, moment, torch.cat((integrals, excess[:, :2]), dim=-1)
