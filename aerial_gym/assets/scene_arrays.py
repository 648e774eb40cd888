# pyright: reportArgumentType=false, reportAssignmentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false, reportOptionalMemberAccess=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""What kernels see of a scene, and the distance of a point to it, as Warp code.

Frames: world of each environment, z up. Letters: E environments, A instances.
"""

import warp as wp

from aerial_gym.assets.geometry import Shape, signed_distance

ABSENT_BELOW = wp.constant(-500.0)
"""Height [m] below which an instance is absent; half way to the parking place, so that drifting there does not matter."""


@wp.struct
class SceneArrays:
    """What a kernel needs to know of a scene."""

    shapes: wp.array[Shape]
    shape_index: wp.array2d[wp.int32]  # (E, A) row of the shape table
    semantic_id: wp.array2d[wp.int32]  # (E, A)
    radius: wp.array2d[float]  # (E, A) of the bounding sphere about the position [m]
    position: wp.array2d[wp.vec3]  # (E, A) world [m]
    attitude: wp.array2d[wp.quat]  # (E, A) shape to world, xyzw, unit


@wp.func
def scene_distance(scene: SceneArrays, env: int, point: wp.vec3, limit: float) -> float:
    """Return the signed distance of a world point to the nearest present instance [m], or ``limit`` if that is smaller."""
    nearest = float(limit)
    for a in range(scene.position.shape[1]):
        position = scene.position[env, a]
        if position[2] > ABSENT_BELOW:
            offset = point - position
            if wp.length(offset) - scene.radius[env, a] < nearest:
                shape = scene.shapes[scene.shape_index[env, a]]
                local = wp.quat_rotate_inv(scene.attitude[env, a], offset)
                nearest = wp.min(nearest, signed_distance(shape, local))
    return nearest
