"""Collision shapes of a robot in kernels: spheres, boxes and capsules, each a core with a radius around it.

The distance to a plane is that of their contact points. The distance to any other surface is the least signed
distance in the core (``nearest``), less the radius.
Frames: centres and attitudes in the body frame. Letters: C shapes.
"""

from collections.abc import Sequence

import torch
import warp as wp

from aerial_gym.assets.cores import shape_core
from aerial_gym.assets.geometry import signed_distance
from aerial_gym.assets.nearest import Core, nearest_of_core
from aerial_gym.assets.scene_arrays import Shape
from aerial_gym.config.robot import CollisionShape


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
    """Return the signed distance of one robot shape to a part [m], at most ``limit``."""
    nearest = float(limit)
    offset = position + wp.quat_rotate(attitude, own.center) - origin
    if wp.length(offset) - shape.radius - own.reach < nearest:
        core = Core(wp.quat_rotate_inv(turn, offset), wp.quat_inverse(turn) * attitude * own.attitude, own.half)
        distance = signed_distance(shape, core.center)
        if own.reach > own.radius and distance - own.reach < nearest:
            pair = nearest_of_core(shape, core, wp.min(distance, nearest + own.radius))
            distance = pair.distance
        nearest = wp.min(nearest, distance - own.radius)
    return nearest


@wp.func
def body_distance(
    shape: Shape, origin: wp.vec3, turn: wp.quat, body: wp.array[BodyShape], position: wp.vec3, attitude: wp.quat,
    limit: float,
) -> float:  # fmt: skip
    """Return the least signed distance of a robot's shapes to a part [m], at most ``limit``.

    Origin and turn are those of the part, position and attitude those of the robot, all world.
    """
    nearest = float(limit)
    for c in range(body.shape[0]):
        nearest = shape_gap(shape, origin, turn, body[c], position, attitude, nearest)
    return nearest


def body_shapes(shapes: Sequence[CollisionShape], *, device: torch.device) -> wp.array:
    """Return the shapes for a kernel, (C,) of ``BodyShape``."""
    rows = []
    for shape in shapes:
        center, attitude, half, radius = shape_core(shape)
        row = BodyShape()
        row.center, row.attitude = wp.vec3(*center.tolist()), wp.quat(*attitude.tolist())
        row.half, row.radius = wp.vec3(*half.tolist()), radius
        row.reach = float(half.norm()) + radius
        rows.append(row)
    return wp.array(rows, dtype=BodyShape, device=wp.device_from_torch(device))
