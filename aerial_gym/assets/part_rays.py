"""Distance along a ray to one part of a scene, as Warp code.

Frames: world of each environment, z up.
"""

import warp as wp

from aerial_gym.assets.geometry import ray_distance_to_other_shape, ray_distance_to_unit_shape
from aerial_gym.assets.scene_arrays import CYLINDER, SceneArrays, part_attitude, part_position


@wp.func
def ray_distance_to_part(scene: SceneArrays, env: int, part: int, start: wp.vec3, ray: wp.vec3, limit: float) -> float:
    """Return the distance from a point along a unit vector to a part [m], at most ``limit``."""
    shape = scene.shapes[scene.part_shape[env, part]]
    turn = part_attitude(scene, env, part)
    origin = wp.quat_rotate_inv(turn, start - part_position(scene, env, part)) - shape.center
    along = wp.quat_rotate_inv(turn, ray)
    origin, along = wp.cw_div(origin, shape.half), wp.cw_div(along, shape.half)
    if shape.kind <= CYLINDER:
        return ray_distance_to_unit_shape(shape.kind, origin, along, limit)
    return ray_distance_to_other_shape(shape, origin, along, limit)
