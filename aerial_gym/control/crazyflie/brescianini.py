"""The controller of Brescianini, Hehn and D'Andrea in the Crazyflie's version: acceleration, reduced attitude, body rates.

It has no memory. Frames: world z up, body x forward, y left, z up; quaternions xyzw. Letters: E environments.
Source: Brescianini, Hehn, D'Andrea (2013), Nonlinear quadrocopter attitude control, ETH Zurich; the loops around it: Lupashin,
Hehn, Mueller, Schoellig, Sherback, D'Andrea (2014), A platform for aerial robotics research and demonstration: the Flying
Machine Arena, Mechatronics 24(1). Parameters are those of the Crazyflie, which omits the report's gyroscopic torque
``w x J w`` (``tests/cross/firmware``).
There, thrust, attitude and rate setpoint run at 100 Hz, the torque at 500 Hz.
"""

from dataclasses import dataclass
from math import tan

import torch
from torch import Tensor

from aerial_gym.control.crazyflie.mellinger import FlatTarget
from aerial_gym.control.lee import LEAST_LIFT, limit_inclination, shortest_turn, tilt_first_error, unit_z
from aerial_gym.math.quaternion import quat_from_yaw, quat_multiply, quat_rotate
from aerial_gym.physics.state import BodyState


@dataclass(frozen=True, kw_only=True)
class BrescianiniGains:
    """Gains of every environment, from the parameters of the Crazyflie; vectors are about x, y, z."""

    mass: Tensor  # [kg], (E, 1)
    inertia: Tensor  # [kg m²], (E, 3, 3)
    position: Tensor  # `1 / tau²` [1/s²], (E, 3)
    velocity: Tensor  # `2 zeta / tau` [1/s], (E, 3)
    attitude: Tensor  # `1 / tau_rp` [1/s], (E, 1)
    mixing: Tensor  # `mixing_factor`: share of the heading error, 0 to 1, (E, 1)
    rate: Tensor  # `1 / tau_rp_rate`, `1 / tau_yaw_rate` [1/s], (E, 3)
    least_thrust: Tensor  # `coll_min`: per mass [m/s²], (E, 1)
    most_thrust: Tensor  # `coll_max`: per mass [m/s²], (E, 1)
    tilt_rate_limit: Tensor  # `omega_rp_max` [rad/s], (E, 1)
    yaw_rate_limit: Tensor  # `omega_yaw_max` [rad/s], (E, 1)


def outer_loop(
    state: BodyState, target: FlatTarget, gains: BrescianiniGains, *, gravity: float,
    max_inclination: float | None = None,
) -> Tensor:  # fmt: skip
    """Return thrust [N] and body-rate setpoint [rad/s], (E, 4), of position and attitude control.

    ``a = e_p / tau² + 2 zeta / tau e_v + a_d + g e_z``. The thrust ``m a_z / (R e_z)_z`` gives the vertical part of a at any
    tilt; a body that points downwards gets the least thrust. The attitude setpoint is the yaw, then the shortest rotation from
    up to a. The rates are ``2 / tau_rp`` times the vector part of the error quaternion, with a share of its heading, plus
    feed-forward.

    Args:
        max_inclination: Largest tilt of a [rad], whose vertical part is then at least a tenth of gravity; None: no limit, for
            targets with an acceleration upwards.
    """
    error, drift = target.position - state.position, target.velocity - state.lin_vel
    weight = target.acceleration + target.acceleration.new_tensor((0.0, 0.0, gravity))
    wanted = gains.position * error + gains.velocity * drift + weight
    if max_inclination is not None:
        wanted = limit_inclination(wanted, torch.full_like(wanted[:, 2], LEAST_LIFT * gravity), tan(max_inclination))
    up = unit_z(wanted)
    collective = wanted[:, 2:] / quat_rotate(state.attitude, up)[:, 2:]
    collective = collective.clamp(gains.least_thrust, gains.most_thrust)
    turn, _ = shortest_turn(up, wanted / wanted.norm(dim=-1, keepdim=True))
    attitude = quat_multiply(turn, quat_from_yaw(target.yaw))
    rates = 2.0 * gains.attitude * tilt_first_error(state.attitude, attitude, gains.mixing) + target.rates
    return torch.cat((gains.mass * collective, _limit_rates(rates, gains)), dim=-1)


def rate_torque(ang_vel: Tensor, wanted: Tensor, gains: BrescianiniGains) -> Tensor:
    """Return the torque ``J (w_d - w) / tau`` [N m], body, (E, 3), for measured and wanted body rates [rad/s], (E, 3)."""
    return (gains.inertia * (gains.rate * (wanted - ang_vel)).unsqueeze(1)).sum(-1)


def _limit_rates(rates: Tensor, gains: BrescianiniGains) -> Tensor:
    """Limit body rates [rad/s], (E, 3); those about x and y keep their common direction."""
    tilting, limit = rates[:, :2], gains.tilt_rate_limit
    tilting = tilting * (limit / torch.maximum(tilting.norm(dim=-1, keepdim=True), limit))
    heading = rates[:, 2:].clamp(-gains.yaw_rate_limit, gains.yaw_rate_limit)
    return torch.cat((tilting, heading), dim=-1)
