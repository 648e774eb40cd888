"""Collision shapes of a robot as cores with a radius around them, and their contact points with a plane.

The core of a sphere is a point, that of a capsule a line, that of a box the box itself, with radius 0. A plane first touches a
corner of the core. So these corners are the *contact points* of a shape, exact for a plane.
Frames: centres and attitudes in the body frame. Letters: C contact points.
"""

from collections.abc import Sequence
from itertools import product

import torch
from torch import Tensor

from aerial_gym.config.robot import BoxCfg, CollisionShape, SphereCfg
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate


def shape_core(shape: CollisionShape) -> tuple[Tensor, Tensor, Tensor, float]:
    """Return centre (3,), attitude (4,), half edges of the core (3,) and radius of a shape, float64."""
    center = torch.tensor(shape.center, dtype=torch.float64)
    if isinstance(shape, SphereCfg):
        return center, torch.tensor([0.0, 0.0, 0.0, 1.0]).double(), torch.zeros(3).double(), shape.radius
    attitude = quat_from_euler(torch.tensor(shape.euler, dtype=torch.float64))
    if isinstance(shape, BoxCfg):
        return center, attitude, 0.5 * torch.tensor(shape.size, dtype=torch.float64), 0.0
    return center, attitude, torch.tensor([0.0, 0.0, 0.5 * shape.height], dtype=torch.float64), shape.radius


def has_boxes_or_capsules(shapes: Sequence[CollisionShape]) -> bool:
    """Return whether any shape is not a sphere."""
    return any(not isinstance(shape, SphereCfg) for shape in shapes)


def contact_points(shapes: Sequence[CollisionShape], *, device: torch.device) -> Tensor:
    """Return the corners of all cores in the body frame and the radii around them [m], float32, (C, 4)."""
    rows = []
    for shape in shapes:
        center, attitude, half, radius = shape_core(shape)
        signs = [(1.0, -1.0) if size > 0.0 else (0.0,) for size in half.tolist()]
        for corner in product(*signs):
            place = center + quat_rotate(attitude, half * torch.tensor(corner, dtype=torch.float64))
            rows.append((*place.tolist(), radius))
    return torch.tensor(rows, dtype=torch.float32, device=device).view(-1, 4)


def body_reach(shapes: Sequence[CollisionShape]) -> float:
    """Return the radius of the shapes about the body origin [m]; 0 without shapes."""
    points = contact_points(shapes, device=torch.device("cpu")).double()
    return float((points[:, :3].norm(dim=1) + points[:, 3]).amax()) if len(points) else 0.0
