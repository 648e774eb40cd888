"""PX4's attitude controller: from attitudes to body rates, with priority of tilt over heading. Pure functions of tensors.

Frames: world z up, body x forward, y left, z up; quaternions xyzw. PX4's frames have opposite y and z in world and body,
which changes signs but not the law. Letters: E environments.
Source: Brescianini, Hehn, D'Andrea (2013), Nonlinear quadrocopter attitude control, ETH Zurich; PX4 Autopilot 1.14,
``AttitudeControl``.
"""

import torch
from torch import Tensor

from aerial_gym.control.reduced_attitude import tilt_first_error
from aerial_gym.math.quaternion import world_up
from aerial_gym.math.rows import unit_vector


def rate_setpoint(
    attitude: Tensor, wanted: Tensor, yaw_rate: Tensor, *, gain: Tensor, yaw_weight: Tensor, limit: Tensor
) -> Tensor:
    """Return the body-rate setpoint [rad/s], (E, 3), for an attitude, with full weight of tilt and less of heading.

    The rates are twice ``reduced_attitude.tilt_first_error``, times the gains, plus the yaw rate.

    Args:
        attitude: Body to world, (E, 4).
        wanted: Wanted attitude, (E, 4).
        yaw_rate: Rate of the wanted heading [rad/s], world, (E,).
        gain: Rates per error [1/s], (E, 3); the yaw gain does not depend on its weight.
        yaw_weight: Share of the heading error in the command, > 0 and <= 1, (E, 1).
        limit: Largest rates [rad/s], (E, 3).
    """
    error = tilt_first_error(attitude, wanted, yaw_weight)
    scaled = torch.cat((gain[:, :2], gain[:, 2:] / yaw_weight), dim=-1)
    rates = 2.0 * scaled * error + yaw_rate.unsqueeze(-1) * world_up(attitude)
    return rates.clamp(-limit, limit)


def attitude_from_thrust(thrust: Tensor, heading: Tensor) -> Tensor:
    """Return the attitude (E, 4) with body z along a thrust (E, 3) and body x in the vertical plane of a heading (E, 3).

    Lee's law takes the axis nearest to the heading instead. Thrusts point upwards, headings are horizontal; both in the world.

    Source: PX4, ``ControlMath::bodyzToAttitude``.
    """
    b3 = unit_vector(thrust)
    left = torch.stack((-heading[:, 1], heading[:, 0], torch.zeros_like(heading[:, 0])), dim=-1)
    b1 = unit_vector(torch.linalg.cross(left, b3))
    return quat_from_axes(b1, torch.linalg.cross(b3, b1), b3)


def quat_from_axes(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Return the quaternion (E, 4), body to world, of body axes x, y, z in the world, (E, 3) each.

    Source: Shepperd (1978), Quaternion from rotation matrix: of four forms the one with the largest divisor.
    """
    xx, yy, zz = x[:, 0], y[:, 1], z[:, 2]
    a, b, c = y[:, 2] - z[:, 1], z[:, 0] - x[:, 2], x[:, 1] - y[:, 0]
    d, e, f = x[:, 1] + y[:, 0], z[:, 0] + x[:, 2], y[:, 2] + z[:, 1]
    forms = (
        torch.stack((1.0 + xx - yy - zz, d, e, a), dim=-1),
        torch.stack((d, 1.0 - xx + yy - zz, f, b), dim=-1),
        torch.stack((e, f, 1.0 - xx - yy + zz, c), dim=-1),
        torch.stack((a, b, c, 1.0 + xx + yy + zz), dim=-1),
    )
    best, divisor = forms[0], forms[0][:, :1]
    for k, form in enumerate(forms[1:], start=1):
        better = form[:, k : k + 1] > divisor
        best, divisor = torch.where(better, form, best), torch.maximum(form[:, k : k + 1], divisor)
    return unit_vector(best)
