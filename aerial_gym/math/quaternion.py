"""Unit quaternions as pure functions of tensors.

Order is ``xyzw``; a quaternion turns body coordinates into world coordinates. Every function takes any leading shape and
float dtype. Sources: Diebel (2006), Representing Attitude; Sola (2017), Quaternion kinematics, section numbers in place.
"""

from math import pi

import torch
from torch import Tensor

from aerial_gym.math.rows import atan2


def quat_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the Hamilton product ``a b``, (..., 4): rotation by ``b``, then by ``a``. Source: Sola (2017), 1.2.2."""
    ax, ay, az, aw = a.unbind(-1)
    bx, by, bz, bw = b.unbind(-1)
    return torch.stack(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ),
        dim=-1,
    )


def quat_conjugate(q: Tensor) -> Tensor:
    """Return the inverse of a unit quaternion, (..., 4)."""
    return torch.cat((-q[..., :3], q[..., 3:]), dim=-1)


def quat_normalize(q: Tensor) -> Tensor:
    """Return ``q / |q|``, (..., 4)."""
    return q / q.norm(dim=-1, keepdim=True)


def quat_rotate(q: Tensor, v: Tensor) -> Tensor:
    """Return ``R(q) v``: body coordinates to world, (..., 3). Derived: ``v + 2 w (u x v) + 2 u x (u x v)``."""
    u, w = q[..., :3], q[..., 3:]
    t = 2.0 * torch.linalg.cross(u, v)
    return v + w * t + torch.linalg.cross(u, t)


def quat_rotate_inverse(q: Tensor, v: Tensor) -> Tensor:
    """Return ``R(q)^T v``: world coordinates to body, (..., 3)."""
    u, w = q[..., :3], q[..., 3:]
    t = 2.0 * torch.linalg.cross(u, v)
    return v - w * t + torch.linalg.cross(u, t)


def world_up(q: Tensor) -> Tensor:
    """Return world z in body coordinates, (..., 3): the last row of ``quat_to_matrix``."""
    x, y, z, w = q.unbind(-1)
    return torch.stack((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)), dim=-1)


def quat_to_matrix(q: Tensor) -> Tensor:
    """Return the rotation matrix R, body to world, (..., 3, 3). Source: Diebel (2006), eq. 125, for xyzw."""
    x, y, z, w = q.unbind(-1)
    rows = (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def quat_exp(rotation: Tensor) -> Tensor:
    """Return the quaternion of a rotation vector [rad], (..., 4). Source: Sola (2017), eq. 101.

    Near zero, ``sin(x/2)/x`` comes from its series, so that value and gradient stay finite.
    """
    square = (rotation * rotation).sum(-1, keepdim=True)
    small = square < 1e-8
    angle = torch.where(small, torch.ones_like(square), square).sqrt()
    factor = torch.where(small, 0.5 - square / 48.0, torch.sin(0.5 * angle) / angle)
    scalar = torch.where(small, 1.0 - square / 8.0, torch.cos(0.5 * angle))
    return torch.cat((factor * rotation, scalar), dim=-1)


def quat_log(q: Tensor) -> Tensor:
    """Return the rotation vector [rad] of at most pi, (..., 3). Source: Sola (2017), eq. 105."""
    q = torch.where(q[..., 3:] < 0.0, -q, q)
    sine = q[..., :3].norm(dim=-1, keepdim=True)
    angle = 2.0 * atan2(sine, q[..., 3:])
    small = sine < 1e-7
    factor = torch.where(small, torch.full_like(sine, 2.0), angle / torch.where(small, torch.ones_like(sine), sine))
    return factor * q[..., :3]


def quat_from_euler(roll_pitch_yaw: Tensor) -> Tensor:
    """Return the quaternion of ZYX Euler angles [rad], R = Rz(yaw) Ry(pitch) Rx(roll), (..., 4)."""
    half = 0.5 * roll_pitch_yaw
    (cr, cp, cy), (sr, sp, sy) = torch.cos(half).unbind(-1), torch.sin(half).unbind(-1)
    return torch.stack(
        (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ),
        dim=-1,
    )


def euler_from_quat(q: Tensor) -> Tensor:
    """Return ZYX roll, pitch, yaw [rad], (..., 3), roll and yaw in (-pi, pi]. Source: Diebel (2006), eq. 290."""
    x, y, z, w = q.unbind(-1)
    roll = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = torch.asin((2.0 * (w * y - z * x)).clamp(-1.0, 1.0))
    return torch.stack((roll, pitch, yaw_from_quat(q)), dim=-1)


def yaw_from_quat(q: Tensor) -> Tensor:
    """Return the yaw [rad] of ``euler_from_quat`` alone, (...), in (-pi, pi]."""
    x, y, z, w = q.unbind(-1)
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def wrap_angle(angle: Tensor) -> Tensor:
    """Return the angle [rad] wrapped to [-pi, pi)."""
    return torch.remainder(angle + pi, 2.0 * pi) - pi


def quat_without_tilt(q: Tensor) -> Tensor:
    """Return the attitude of the *vehicle* frame: ``q`` without roll and pitch, a rotation about world z, (..., 4)."""
    return quat_from_yaw(yaw_from_quat(q))


def quat_from_yaw(yaw: Tensor) -> Tensor:
    """Return the rotation by ``yaw`` [rad] about world z, (..., 4)."""
    half = 0.5 * yaw
    zero = torch.zeros_like(half)
    return torch.stack((zero, zero, torch.sin(half), torch.cos(half)), dim=-1)
