"""Rows of the shape table, and arrays and poses of a scene in kernels, as Warp code.

Frames: world of each environment, z up. Letters: E environments, A instances, P parts of all instances together, L links of all
vehicles that are seen.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError


def check_tensor(
    name: str, tensor: Tensor, shape: tuple[int, ...], *, device: torch.device, dtype: torch.dtype = torch.float32
) -> None:
    """Raise ``ShapeError`` unless a tensor has this shape, dtype and device; ``cuda`` matches any index."""
    same_device = tensor.device.type == device.type and device.index in (None, tensor.device.index)
    if tuple(tensor.shape) != shape or tensor.dtype != dtype or not same_device:
        raise ShapeError(
            f"{name} is {tuple(tensor.shape)} {tensor.dtype} on {tensor.device}, expected {shape} {dtype} on {device}"
        )


def vector_view(name: str, tensor: Tensor, shape: tuple[int, ...], *, device: torch.device) -> wp.array:
    """Return a Warp array of vectors (last axis 3) or quaternions (4) on the memory of a tensor strided in other axes."""
    check_tensor(name, tensor, shape, device=device)
    if tensor.stride(-1) != 1:
        raise ShapeError(f"{name} has stride {tensor.stride()}: the last axis must be contiguous")
    return wp.from_torch(tensor, dtype=wp.vec3 if shape[-1] == 3 else wp.quat)


BOX = wp.constant(0)
SPHERE = wp.constant(1)
CYLINDER = wp.constant(2)
CAPSULE = wp.constant(3)
MESH = wp.constant(4)
PLANE = wp.constant(5)  # Half space below z = 0 of its own frame
TRIANGLE = wp.constant(6)  # One face of a mesh in a sweep, in no table; corners are `size`, `center` and `half`


@wp.struct
class Shape:
    """One row of the shape table."""

    mesh: wp.uint64  # Warp mesh id for distances; 0 unless kind is MESH
    ray_mesh: wp.uint64  # the same triangles in a tree optimised for rays
    position: wp.vec3  # of the shape in the frame of its asset [m]
    attitude: wp.quat  # shape to asset, xyzw, unit
    kind: wp.int32  # BOX, SPHERE, CYLINDER, CAPSULE, MESH, PLANE or TRIANGLE
    radius: wp.float32  # of the bounding sphere about the shape's origin [m]
    size: wp.vec3  # box: half edges; else: radius, half height along z, 0 [m]
    center: wp.vec3  # of the bounding box in the shape's own axes [m]; 0 but for meshes
    half: wp.vec3  # half edges of the bounding box [m]


ABSENT_BELOW = wp.constant(-500.0)  # Height of absent instances [m]: half the parking depth, against drift
WORLD, BODY = wp.constant(-1), wp.constant(-2)  # Carriers of other parts; link k is `BODY - k`


@wp.struct
class SceneArrays:
    """Arrays of a scene for kernels."""

    shapes: wp.array[Shape]
    part_shape: wp.array2d[wp.int32]  # (E, P) row of the shape table, -1 where there is no part
    part_instance: wp.array2d[wp.int32]  # (E, P) carrier: an instance, WORLD, or BODY - link
    num_solid: wp.int32  # parts from this index on are visible only
    semantic_id: wp.array2d[wp.int32]  # (E, P)
    radius: wp.array2d[float]  # (E, P) of the bounding sphere about the part's origin [m]
    position: wp.array2d[wp.vec3]  # (E, A) world [m]
    attitude: wp.array2d[wp.quat]  # (E, A) instance to world, xyzw, unit
    link_position: wp.array2d[
        wp.vec3
    ]  # (E, L) of the vehicles' links, world [m]; empty where none is seen, as the next two
    link_attitude: wp.array2d[wp.quat]  # (E, L) link to world, xyzw, unit
    link_is_base: wp.array[wp.bool]  # (L,) whether it is the base of a vehicle


@wp.func
def part_position(scene: SceneArrays, env: int, part: int) -> wp.vec3:
    """Return the position of a part's origin [m], world."""
    a = scene.part_instance[env, part]
    offset = scene.shapes[scene.part_shape[env, part]].position
    if a == WORLD:
        return offset
    if a <= BODY:
        k = BODY - a
        return scene.link_position[env, k] + wp.quat_rotate(scene.link_attitude[env, k], offset)
    return scene.position[env, a] + wp.quat_rotate(scene.attitude[env, a], offset)


@wp.func
def part_attitude(scene: SceneArrays, env: int, part: int) -> wp.quat:
    """Return the attitude of a part, part to world, xyzw."""
    a = scene.part_instance[env, part]
    turn = scene.shapes[scene.part_shape[env, part]].attitude
    if a == WORLD:
        return turn
    if a <= BODY:
        return scene.link_attitude[env, BODY - a] * turn
    return scene.attitude[env, a] * turn


@wp.func
def part_is_present(scene: SceneArrays, env: int, part: int) -> wp.bool:
    """Return whether a part exists and its instance is not parked."""
    if scene.part_shape[env, part] < 0:
        return False
    a = scene.part_instance[env, part]
    if a < 0:
        return True
    return scene.position[env, a][2] > ABSENT_BELOW
