"""The collision shapes of a robot: spheres, boxes and capsules, all of them a core with a radius around it.

The core of a sphere is a point, that of a capsule a line, that of a box the box itself, with radius 0. What a plane touches
first is one of the core's corners, which are the *contact points* of a shape: for a plane they are exact.

The distance to any other surface is the least signed distance in the core (``nearest``), less the radius.
Frames: centres and attitudes in the body frame. Letters: C shapes or contact points.
"""

from collections.abc import Sequence
from itertools import product

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.geometry import Shape, signed_distance
from aerial_gym.assets.nearest import Core, nearest_of_core
from aerial_gym.config.robot import BoxCfg, CollisionShape, SphereCfg
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate


@wp.struct
class BodyShape:
    """One collision shape."""

    center: wp.vec3  # of the core, body frame [m]
    attitude: wp.quat  # core to body, xyzw, unit
    half: wp.vec3  # half edges of the core [m]
    radius: wp.float32  # around the core [m]
    reach: wp.float32  # of the shape from its centre [m]


@wp.func
def shape_gap(
    shape: Shape, origin: wp.vec3, turn: wp.quat, own: BodyShape, position: wp.vec3, attitude: wp.quat, limit: float
) -> float:
    """Return the least signed distance of one of a robot's shapes to a part [m], or ``limit`` if that is smaller."""
    nearest = float(limit)
    offset = position + wp.quat_rotate(attitude, own.center) - origin
    if wp.length(offset) - shape.radius - own.reach < nearest:
        core = Core()
        core.center = wp.quat_rotate_inv(turn, offset)
        core.turn = wp.quat_inverse(turn) * attitude * own.attitude
        core.half = own.half
        distance = signed_distance(shape, core.center)
        if own.reach > own.radius and distance - own.reach < nearest:
            found = nearest_of_core(shape, core, wp.min(distance, nearest + own.radius))
            distance = found.distance
        nearest = wp.min(nearest, distance - own.radius)
    return nearest


@wp.func
def body_distance(
    shape: Shape,
    origin: wp.vec3,
    turn: wp.quat,
    body: wp.array[BodyShape],
    position: wp.vec3,
    attitude: wp.quat,
    limit: float,
) -> float:
    """Return the least signed distance of a robot's shapes to a part [m], or ``limit`` if that is smaller.

    Origin and turn are those of the part, position and attitude those of the robot, all world.
    """
    nearest = float(limit)
    for c in range(body.shape[0]):
        nearest = shape_gap(shape, origin, turn, body[c], position, attitude, nearest)
    return nearest


@wp.func
def body_reach_in_step(
    body: wp.array[BodyShape], position: wp.array2d[wp.vec3], attitude: wp.array2d[wp.quat], env: int, last: int
) -> float:
    """Return the largest distance of a point of a core from its last place at any of the poses of a step [m]."""
    reach = wp.float32(0.0)
    for c in range(body.shape[0]):
        own = body[c]
        end = position[last, env] + wp.quat_rotate(attitude[last, env], own.center)
        for k in range(last):
            place = position[k, env] + wp.quat_rotate(attitude[k, env], own.center)
            turned = wp.quat_inverse(attitude[last, env]) * attitude[k, env]
            chord = 2.0 * wp.length(wp.vec3(turned[0], turned[1], turned[2])) * (own.reach - own.radius)
            reach = wp.max(reach, wp.length(place - end) + chord)
    return reach


def core_of(shape: CollisionShape) -> tuple[Tensor, Tensor, Tensor, float]:
    """Return centre (3,), attitude (4,), half edges of the core (3,) and radius of a shape, float64."""
    center = torch.tensor(shape.center, dtype=torch.float64)
    if isinstance(shape, SphereCfg):
        return center, torch.tensor([0.0, 0.0, 0.0, 1.0]).double(), torch.zeros(3).double(), shape.radius
    attitude = quat_from_euler(torch.tensor(shape.euler, dtype=torch.float64))
    if isinstance(shape, BoxCfg):
        return center, attitude, 0.5 * torch.tensor(shape.size, dtype=torch.float64), 0.0
    return center, attitude, torch.tensor([0.0, 0.0, 0.5 * shape.height], dtype=torch.float64), shape.radius


def has_cores(shapes: Sequence[CollisionShape]) -> bool:
    """Return whether there is anything but spheres."""
    return any(not isinstance(shape, SphereCfg) for shape in shapes)


def body_shapes(shapes: Sequence[CollisionShape], *, device: torch.device) -> wp.array:
    """Return the shapes as a kernel takes them, (C,) of ``BodyShape``."""
    rows = []
    for shape in shapes:
        center, attitude, half, radius = core_of(shape)
        row = BodyShape()
        row.center, row.attitude = wp.vec3(*center.tolist()), wp.quat(*attitude.tolist())
        row.half, row.radius = wp.vec3(*half.tolist()), radius
        row.reach = float(half.norm()) + radius
        rows.append(row)
    return wp.array(rows, dtype=BodyShape, device=wp.device_from_torch(device))


def contact_points(shapes: Sequence[CollisionShape], *, device: torch.device) -> Tensor:
    """Return the corners of all cores in the body frame and the radii around them [m], float32, (C, 4)."""
    rows = []
    for shape in shapes:
        center, attitude, half, radius = core_of(shape)
        signs = [(1.0, -1.0) if size > 0.0 else (0.0,) for size in half.tolist()]
        for corner in product(*signs):
            place = center + quat_rotate(attitude, half * torch.tensor(corner, dtype=torch.float64))
            rows.append((*place.tolist(), radius))
    return torch.tensor(rows, dtype=torch.float32, device=device).view(-1, 4)


def body_reach(shapes: Sequence[CollisionShape]) -> float:
    """Return how far the shapes reach from the body origin [m]; 0 without any."""
    points = contact_points(shapes, device=torch.device("cpu")).double()
    return float((points[:, :3].norm(dim=1) + points[:, 3]).amax()) if len(points) else 0.0
