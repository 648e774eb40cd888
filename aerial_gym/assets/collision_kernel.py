"""The kernel of the collision test: moves the obstacles, sweeps the robot's shapes against them and measures the distance.

A block of threads treats one vehicle, and each thread some parts of its environment. The thread moves the instance of a moving
part through the substeps and sweeps the robot's shapes against it (``sweep``). It then measures the distance of each part at
the last pose, unless a nearer part is known. On the CPU a block is one thread.

Parts at rest are swept afterwards, by threads whose nearest part is within the robot's displacement in the step: a signed
distance changes by no more than the point moves. Each thread of a block bounds the displacement from one of the poses. The
sign of a mesh comes from a winding number and may jump, so only its bounding sphere rules a mesh out, and its sign is tested
at every pose. Separate kernels omit boxes and capsules, meshes, or moving obstacles.
Frames: centres of shapes in the body frame, poses in the environment's world frame. Letters: E environments, A instances, P
parts of all instances, B vehicles of all environments, C shapes, K substeps.
"""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.assets.body_shapes import BodyShape, body_distance
from aerial_gym.assets.geometry import extent_in_direction, primitive_distance, primitive_normal, signed_distance
from aerial_gym.assets.obstacle_motion import advance_pose, is_present_and_moves, move_instance
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, MESH, WORLD, SceneArrays, Shape
from aerial_gym.assets.sweep import (
    MAX_STEPS,
    NEAR,
    make_moving_sweep,
    make_path,
    make_static_sweep,
    relative_sagitta,
    time_to_plane,
)


@wp.func
def _ball_touches(
    shape: Shape, start: wp.vec3, shift: wp.vec3, across: wp.vec3, beside: wp.vec3, angle: float, radius: float
) -> wp.bool:
    """Return whether a ball touches a part at rest that is no mesh, between times 0 and 1.

    At time t its centre is at ``start + t shift + cos(t angle) across + sin(t angle) beside``, in the frame of the part [m].
    """
    speed = wp.length(shift) + angle * wp.length(across)
    t = wp.float32(0.0)
    k = wp.int32(0)
    while k < wp.static(MAX_STEPS):
        k += 1
        cosine = wp.cos(t * angle)
        sine = wp.sin(t * angle)
        center = start + t * shift + cosine * across + sine * beside
        distance = primitive_distance(shape, center) - radius
        left = 1.0 - t
        if distance - NEAR > left * speed:
            return False
        if distance < 0.0:
            return True
        normal = primitive_normal(shape, center)
        towards = -wp.dot(normal, shift + angle * (cosine * beside - sine * across))
        bend = angle * angle * wp.length(wp.vec2(wp.dot(normal, across), wp.dot(normal, beside)))
        height = wp.dot(normal, center) - extent_in_direction(shape, normal) - radius
        wait = wp.max(distance - 0.5 * NEAR, 0.0) / wp.max(speed, 1.0e-20)
        if height >= -0.25 * NEAR:
            safe = wp.max(height - 0.5 * NEAR, 0.5 * wp.max(height, 0.0))  # the rest is a margin for rounding
            wait = wp.max(wait, time_to_plane(safe, towards, bend))
        if wait >= left:
            return False
        if distance < NEAR:
            return True
        t += wait
    return True


@wp.func
def spheres_touch_static(
    shape: Shape, x: wp.vec3, q: wp.quat, _radius: float, body: wp.array[wp.vec4], _hull: float, pivot: wp.vec3,
    position: wp.array2d[wp.vec3], attitude: wp.array2d[wp.quat], own: int,
) -> wp.bool:  # fmt: skip
    """Return whether a sphere touches the part, as ``touches_static`` does.

    The nearest pair at the last pose gives a plane. It clears nearly all substeps, those wholly above it, at once.
    """
    origin = x + wp.quat_rotate(q, shape.position)
    turn = q * shape.attitude
    last = position.shape[0] - 1
    c = wp.int32(0)
    while c < body.shape[0]:
        center = wp.vec3(body[c][0], body[c][1], body[c][2])
        ball = body[c][3]
        lever = wp.length(center - pivot)
        local = wp.quat_rotate_inv(turn, position[last, own] + wp.quat_rotate(attitude[last, own], center) - origin)
        normal = primitive_normal(shape, local)
        outward = wp.quat_rotate(turn, normal)
        surface = extent_in_direction(shape, normal) + ball + NEAR
        k = wp.int32(0)
        while k < last:
            x0 = position[k, own]
            q0 = attitude[k, own]
            k += 1
            x1 = position[k, own]
            q1 = attitude[k, own]
            before = wp.dot(outward, x0 + wp.quat_rotate(q0, center) - origin)
            after = wp.dot(outward, x1 + wp.quat_rotate(q1, center) - origin)
            if wp.min(before, after) <= surface + lever * relative_sagitta(q0, q1):
                path = make_path(pivot, x0, q0, x1, q1)
                angle = wp.length(path.turn)
                axis = path.turn / wp.max(angle, 1.0e-20)
                arm = wp.quat_rotate(q0, center - pivot)
                along = wp.dot(axis, arm) * axis
                if _ball_touches(
                    shape,
                    wp.quat_rotate_inv(turn, path.start + along - origin),
                    wp.quat_rotate_inv(turn, path.shift),
                    wp.quat_rotate_inv(turn, arm - along),
                    wp.quat_rotate_inv(turn, wp.cross(axis, arm)),
                    angle,
                    ball,
                ):
                    return True
        c += 1
    return False


REGISTERS = 96
"""Largest number of registers of a thread of the smallest kernel: ten blocks of 64 threads fit a multiprocessor's 65,536.

On an H200, 64 to 128 registers take the same time within 5 %. Without a limit the kernel takes 168.
"""

MARGIN = wp.constant(1.0e-3)  # Margin for float32 rounding [m] of parts beyond the displacement: 6e-5 m at 1 km


@wp.struct
class NoObstacles:
    """Small stand-in for absent moving obstacles: the cost of a launch grows with the size of its arguments."""

    unused: int


@cache
def _make_sphere_gap(*, meshes: bool) -> wp.Function:
    """Return the function for the distance of spheres to a part; ``meshes``: whether any part is a mesh (many registers)."""
    distance_to = signed_distance if meshes else primitive_distance

    @wp.func
    def sphere_gap(
        shape: Shape, origin: wp.vec3, turn: wp.quat, sphere: wp.array[wp.vec4], position: wp.vec3, attitude: wp.quat,
        limit: float,
    ) -> float:  # fmt: skip
        """Return the least signed distance of the robot's spheres to a part [m], at most ``limit``."""
        nearest = float(limit)
        for c in range(sphere.shape[0]):
            row = sphere[c]
            radius = row[3]
            offset = position + wp.quat_rotate(attitude, wp.vec3(row[0], row[1], row[2])) - origin
            if wp.length(offset) - shape.radius - radius < nearest:
                nearest = wp.min(nearest, distance_to(shape, wp.quat_rotate_inv(turn, offset)) - radius)
        return nearest

    return sphere_gap


@wp.func
def _part_pose(scene: SceneArrays, env: int, part: int):  # fmt: skip
    """Return a part's shape row, its instance and the pose of its carrier; row -1 if the part is absent."""
    row = scene.part_shape[env, part]
    a = scene.part_instance[env, part]
    x = wp.vec3()
    q = wp.quat_identity()
    if row >= 0 and a != WORLD:
        x = scene.position[env, a]
        q = scene.attitude[env, a]
    if x[2] <= ABSENT_BELOW:
        row = -1
    return row, a, x, q


@wp.func
def _displacement_bound(
    position: wp.array2d[wp.vec3], attitude: wp.array2d[wp.quat], hull: float, own: int, k: int
) -> float:
    """Return an upper bound of the displacement of any hull point from pose k to the last pose [m]."""
    last = position.shape[0] - 1
    ahead = attitude[last, own] - attitude[k, own]
    behind = attitude[last, own] + attitude[k, own]  # -q is the same attitude as q
    chord = 2.0 * wp.sqrt(wp.min(wp.dot(ahead, ahead), wp.dot(behind, behind)))  # 4 sin(angle / 4) >= 2 sin(angle / 2)
    return wp.length(position[k, own] - position[last, own]) + hull * chord


@cache
def make_collision_kernel(*, moves: bool, shared: bool, cores: bool, meshes: bool) -> wp.Kernel:
    """Return the kernel of the collision test.

    ``moves``: obstacles move. ``shared``: the threads of a block share an environment; GPU only, as Warp's block reductions
    must not run on two CPU threads at once. ``cores``: the robot has boxes or capsules. ``meshes``: any part is a mesh.
    """
    body_type = wp.array[BodyShape] if cores else wp.array[wp.vec4]
    gap_of = body_distance if cores else _make_sphere_gap(meshes=meshes)
    obstacles_type: Any = Obstacles if moves else NoObstacles
    meets_still = make_static_sweep(cores=cores, meshes=meshes) if cores or meshes else spheres_touch_static
    meets_moving = make_moving_sweep(cores=cores, meshes=meshes)
    lean = not (moves or cores or meshes)

    @wp.kernel(module="unique", enable_backward=False, cuda_max_registers=REGISTERS if lean else None)
    def collide(
        # scene
        scene: SceneArrays,
        # state
        position: wp.array2d[wp.vec3],  # (K + 1, B) at the start of a step and after each substep, or (1, B), world [m]
        attitude: wp.array2d[wp.quat],  # (K + 1, B) body to world, xyzw
        # params
        body: body_type,  # (C,) spheres (centre in the body frame, radius [m]), or ``BodyShape``
        hull: float,  # radius of a ball about the body origin that holds all shapes [m]
        pivot: wp.vec3,  # point that moves straight between poses, body frame [m]
        dt: float,  # [s] of a substep
        is_step: wp.bool,  # whether obstacles move with the poses, and contacts are crashes
        joins: wp.bool,  # whether another link was measured before this one
        moves_obstacles: wp.bool,  # whether obstacles end where they are after the step
        vehicles: int,  # in an environment
        first: int,  # vehicle of the first block
        # out
        obstacles_out: obstacles_type,
        distance_out: wp.array[float],  # (B,) [m]
        crashes_out: wp.array[wp.bool],  # (B,) set at a contact at or between the poses
    ):
        """Write the least signed distance between shapes and parts at the last pose, inf without parts."""
        block, lane = wp.tid()
        own = block + first
        env = own // vehicles
        last = position.shape[0] - 1
        nearest = float(wp.inf)
        touches = wp.bool(False)
        reach = wp.float32(0.0)
        for k in range(lane, last, wp.block_dim()):
            ends = wp.max(
                _displacement_bound(position, attitude, hull, own, k),
                _displacement_bound(position, attitude, hull, own, k + 1),
            )
            bow = (hull + wp.length(pivot)) * relative_sagitta(attitude[k, own], attitude[k + 1, own])
            reach = wp.max(reach, ends + bow + MARGIN)
        for part in range(lane, scene.num_solid, wp.block_dim()):
            row, a, x, q = _part_pose(scene, env, part)
            if row >= 0:
                if wp.static(moves):  # noqa: SIM102 (only what stands alone is static)
                    if a != WORLD and is_step and is_present_and_moves(obstacles_out, env, a):
                        v = obstacles_out.lin_vel[env, a]
                        solid = scene.shapes[row]
                        room = scene.radius[env, part]
                        for k in range(last):
                            p = position[k, own]
                            path = make_path(pivot, p, attitude[k, own], position[k + 1, own], attitude[k + 1, own])
                            touches = touches or meets_moving(
                                obstacles_out, env, a, x, q, v, dt, solid, room, body, hull, path
                            )
                            if wp.static(meshes):  # noqa: SIM102 (only what stands alone is static)
                                if solid.kind == MESH and not touches:
                                    origin = x + wp.quat_rotate(q, solid.position)
                                    if wp.length(p - origin) - room - hull < 0.0:
                                        turn = q * solid.attitude
                                        touches = gap_of(solid, origin, turn, body, p, attitude[k, own], 0.0) < 0.0
                            x, q, v = advance_pose(obstacles_out, env, a, x, q, v, dt)
                p = position[last, own]
                origin = x + wp.quat_rotate(q, scene.shapes[row].position)
                if wp.length(p - origin) - scene.radius[env, part] - hull < nearest:
                    shape = scene.shapes[row]
                    nearest = gap_of(shape, origin, q * shape.attitude, body, p, attitude[last, own], nearest)
        touches = touches or nearest < 0.0
        if wp.static(shared):
            reach = wp.tile_max(wp.tile(reach))[0]
        may_meet = is_step and not touches and nearest < reach
        if wp.static(meshes):
            may_meet = is_step and not touches
        if may_meet:
            for part in range(lane, scene.num_solid, wp.block_dim()):
                row, a, x, q = _part_pose(scene, env, part)
                rests = row >= 0 and not touches
                if wp.static(moves):
                    rests = rests and not (a != WORLD and is_present_and_moves(obstacles_out, env, a))
                if rests:
                    shape = scene.shapes[row]
                    radius = scene.radius[env, part]
                    origin = x + wp.quat_rotate(q, shape.position)
                    offset = position[last, own] - origin
                    apart = wp.length(offset) - radius
                    if wp.static(cores):  # whose sweep costs more
                        apart = wp.max(apart, primitive_distance(shape, wp.quat_rotate_inv(q * shape.attitude, offset)))
                    if apart - hull < reach:
                        touches = meets_still(shape, x, q, radius, body, hull, pivot, position, attitude, own)
                        if wp.static(meshes) and shape.kind == MESH:
                            for k in range(last):
                                p = position[k, own]
                                if not touches and wp.length(p - origin) - radius - hull < 0.0:
                                    at = gap_of(shape, origin, q * shape.attitude, body, p, attitude[k, own], 0.0)
                                    touches = at < 0.0
        if touches and is_step:
            crashes_out[own] = True
        least = nearest
        if wp.static(shared):
            least = wp.tile_min(wp.tile(nearest))[0]  # waits for all threads of the block: none reads a pose after it
        if lane == 0:
            if joins:
                least = wp.min(least, distance_out[own])
            distance_out[own] = least
        if wp.static(moves):  # noqa: SIM102 (only what stands alone is static)
            if moves_obstacles:
                for a in range(lane, obstacles_out.asset.shape[1], wp.block_dim()):
                    move_instance(obstacles_out, env, a, dt, last)

    return collide
