# pyright: reportArgumentType=false, reportAssignmentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportReturnType=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false, reportOptionalMemberAccess=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""What kernels see of a scene, and the distance of a point to it, as Warp code.

Frames: world of each environment, z up. Letters: E environments, A instances, P parts of all instances together.
"""

import warp as wp

from aerial_gym.assets.geometry import Shape, signed_distance

ABSENT_BELOW = wp.constant(-500.0)
"""Height [m] below which an instance is absent; half way to the parking place, so that drifting there does not matter."""


@wp.struct
class SceneArrays:
    """What a kernel needs to know of a scene."""

    shapes: wp.array[Shape]
    part_shape: wp.array2d[wp.int32]  # (E, P) row of the shape table, -1 where there is no part
    part_instance: wp.array2d[wp.int32]  # (E, P) which instance carries it
    semantic_id: wp.array2d[wp.int32]  # (E, P)
    radius: wp.array2d[float]  # (E, P) of the bounding sphere about the part's origin [m]
    position: wp.array2d[wp.vec3]  # (E, A) world [m]
    attitude: wp.array2d[wp.quat]  # (E, A) instance to world, xyzw, unit


@wp.func
def part_position(scene: SceneArrays, env: int, part: int) -> wp.vec3:
    """Return where the origin of a part is [m], world."""
    a = scene.part_instance[env, part]
    offset = scene.shapes[scene.part_shape[env, part]].position
    return scene.position[env, a] + wp.quat_rotate(scene.attitude[env, a], offset)


@wp.func
def part_attitude(scene: SceneArrays, env: int, part: int) -> wp.quat:
    """Return how a part is turned, part to world."""
    turn = scene.shapes[scene.part_shape[env, part]].attitude
    return scene.attitude[env, scene.part_instance[env, part]] * turn


@wp.func
def part_is_present(scene: SceneArrays, env: int, part: int) -> wp.bool:
    """Return whether there is such a part and its instance is not parked."""
    if scene.part_shape[env, part] < 0:
        return False
    return scene.position[env, scene.part_instance[env, part]][2] > ABSENT_BELOW


@wp.func
def scene_distance(scene: SceneArrays, env: int, point: wp.vec3, limit: float) -> float:
    """Return the signed distance of a world point to the nearest present part [m], or ``limit`` if that is smaller."""
    nearest = float(limit)
    for part in range(scene.part_shape.shape[1]):
        if part_is_present(scene, env, part):
            offset = point - part_position(scene, env, part)
            if wp.length(offset) - scene.radius[env, part] < nearest:
                shape = scene.shapes[scene.part_shape[env, part]]
                local = wp.quat_rotate_inv(part_attitude(scene, env, part), offset)
                nearest = wp.min(nearest, signed_distance(shape, local))
    return nearest
