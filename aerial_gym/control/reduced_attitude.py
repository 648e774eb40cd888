"""The reduced-attitude error: rotation to an attitude with tilt before heading. Pure functions of tensors.

Frames: world z up, body x forward, y left, z up; quaternions xyzw. Letters: E environments.
Source: Brescianini, Hehn, D'Andrea (2013), Nonlinear quadrocopter attitude control, ETH Zurich.
"""

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_conjugate, quat_multiply, quat_rotate
from aerial_gym.math.rows import atan2

OPPOSITE = 1e-5  # Length of `a x b` below which opposite a and b have no shortest rotation. Source: PX4, `matrix`


def shortest_turn(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Return the quaternion (E, 4) of the shortest rotation from unit vectors a to b (E, 3), and whether it exists (E, 1).

    Source: Derived: ``(a x b, 1 + a . b)``, normalised.
    """
    cross, dot = torch.linalg.cross(a, b), (a * b).sum(-1, keepdim=True)
    exists = ((cross * cross).sum(-1, keepdim=True) >= OPPOSITE**2) | (dot > 0.0)
    half = torch.cat((cross, torch.where(exists, 1.0 + dot, 1.0)), dim=-1)
    return half / half.norm(dim=-1, keepdim=True), exists


def canonical_quat(q: Tensor) -> Tensor:
    """Return the equal rotation with ``w >= 0``, (E, 4)."""
    return torch.where(q[:, 3:] < 0.0, -q, q)


def unit_z(like: Tensor) -> Tensor:
    """Return a unit vector along z for every row, (E, 3)."""
    return like.new_tensor((0.0, 0.0, 1.0)).expand(len(like), 3)


def unit_x(like: Tensor) -> Tensor:
    """Return a unit vector along x for every row, (E, 3)."""
    return like.new_tensor((1.0, 0.0, 0.0)).expand(len(like), 3)


def tilt_first_error(attitude: Tensor, wanted: Tensor, yaw_share: Tensor) -> Tensor:
    """Return the vector part of the error quaternion, body, (E, 3): shortest rotation of body z, then a share of the heading.

    Args:
        attitude: Body to world, (E, 4).
        wanted: Wanted attitude, (E, 4).
        yaw_share: Share of the heading error, 0 to 1, (E, 1).
    """
    turn, exists = shortest_turn(*(quat_rotate(q, unit_z(q)) for q in (attitude, wanted)))
    tilted = torch.where(exists, quat_multiply(turn, attitude), wanted)
    heading = canonical_quat(quat_multiply(quat_conjugate(tilted), wanted))
    half = yaw_share * atan2(heading[:, 2:3], heading[:, 3:])
    zero = torch.zeros_like(half)
    part = torch.cat((zero, zero, torch.sin(half), torch.cos(half)), dim=-1)
    return canonical_quat(quat_multiply(quat_conjugate(attitude), quat_multiply(tilted, part)))[:, :3]
