"""Swept collision test of fast robots and thin obstacles within one substep, as Warp code.

Contact acts on overlaps at the end of a substep, away from the nearest surface. A robot that moves further than the thickness
of a part would then be behind it. Therefore its shapes are swept along the substep (``assets.sweep``). A shape *crosses* a part
if it touches the part on the way, and ends below the plane of that touch without a contact force back above it.

Each crossing gives this plane. A shift along the normals puts the robot no deeper than at its touch; its motion along the
planes stays. The contact law then acts on the depth of the unshifted path. This depth is at most the speed times ``dt``, so
the implicit law removes speed and reverses nothing.
The shifted path is swept again. After ``ROUNDS`` without a clear path the robot stays at its first pose.

Limits: an obstacle that bounces or wraps within the substep is not swept here. The contact normal of a box or capsule that
pierces a mesh is ambiguous, so that it may be pushed through; its touch is still detected.
Frames: world, z up; shapes in the frame of the body. Letters: E environments, C shapes.
"""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.assets.body_shapes import BodyShape
from aerial_gym.assets.geometry import outward_normal, primitive_distance, primitive_normal, signed_distance, support
from aerial_gym.assets.nearest import Core, Nearest, nearest_of_core
from aerial_gym.assets.obstacle_motion import advance_pose, instance_moves, next_reversal
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, SceneArrays
from aerial_gym.assets.shape_row import MESH, TRIANGLE, Shape
from aerial_gym.assets.sweep import (
    EDGE,
    NEAR,
    Path,
    as_body_shape,
    face_shape,
    local_center,
    make_path,
    make_touch_time,
    path_attitude,
    sweep_bounds,
)
from aerial_gym.math.warp_functions import rotate
from aerial_gym.physics.fused.contact import point_velocity
from aerial_gym.physics.fused.hook import Substep
from aerial_gym.robots.contact_pairs import ContactPairs, SceneMotion

ROUNDS = wp.constant(4)  # as many as a vec4 has numbers
"""Largest number of planes that stop a robot in one substep, and of sweeps for them."""

PASSES = 8
"""Shifts along each normal in turn; between two walls at a right angle one is enough."""


@wp.struct
class Crossing:
    """The first crossing of a substep."""

    time: float  # of the touch, as a share of the substep; inf without one
    normal: wp.vec3  # of the plane at the end of the substep, towards the robot, world
    gap: float  # of the shape at the end of the substep, from the plane [m], < 0
    floor: float  # at the touch, or 0 if that is smaller [m]
    lever: wp.vec3  # from the centre of mass to the point that touched, world [m]
    surface_vel: wp.vec3  # world [m/s]


@wp.struct
class CrossingStop:
    """Pose and contacts at which a robot's path is stopped."""

    crosses: wp.bool  # whether anything is in its way
    crashes: wp.bool  # whether it touches at the speed of a crash
    pairs: ContactPairs  # crossed surfaces
    position: wp.vec3  # of the centre of mass, world [m]
    attitude: wp.quat  # body to world


@wp.func
def substep_path(done: Substep) -> Path:
    """Return the path of a body in a substep, with the centre of mass on a straight line."""
    first = done.first_position - rotate(done.first_attitude, done.com)
    last = done.position - rotate(done.attitude, done.com)
    return make_path(done.com, first, done.first_attitude, last, done.attitude)


@wp.func
def _transform_core(shape: Shape, other: Path, own: BodyShape, path: Path, t: float) -> Core:
    """Return the core of the robot's shape in the frame of a part."""
    core = Core()
    core.center = local_center(shape, other, own, path, t)
    core.turn = wp.quat_inverse(path_attitude(other, t) * shape.attitude) * path_attitude(path, t) * own.attitude
    core.half = own.half
    return core


@wp.func
def _core_depth(core: Core, normal: wp.vec3) -> float:
    """Return the half extent of a core along a direction [m], the support function of a box."""
    own = wp.quat_rotate_inv(core.turn, normal)
    return wp.dot(core.half, wp.vec3(wp.abs(own[0]), wp.abs(own[1]), wp.abs(own[2])))


@wp.func
def _lift_shift(pairs: ContactPairs, floors: wp.vec4, count: int, shift: wp.vec3) -> wp.vec3:
    """Return the shift [m] that puts a robot no deeper below any plane than its floor."""
    for _k in range(wp.static(PASSES)):
        for i in range(count):
            deeper = floors[i] - pairs.gaps[i] - wp.dot(pairs.normals[i], shift)
            shift += wp.max(deeper, 0.0) * pairs.normals[i]
    return shift


@cache
def _make_nearest_pair(*, cores: bool) -> wp.Function:
    @wp.func
    def nearest_pair(solid: Shape, own: BodyShape, core: Core) -> Nearest:
        """Return the nearest pair of a part, or of a face, and a shape that touches it; the point is on the shape."""
        pair = Nearest()
        pair.point = core.center
        pair.distance = primitive_distance(solid, core.center)
        pair.normal = primitive_normal(solid, core.center)
        if wp.static(cores):  # noqa: SIM102 (wp.static must be the whole condition)
            if own.reach > own.radius:
                hit = nearest_of_core(solid, core, pair.distance)
                if hit.distance < pair.distance:
                    pair = hit
        if solid.kind == TRIANGLE and pair.distance <= 0.0:
            flat = wp.normalize(wp.cross(solid.center - solid.size, solid.half - solid.size))
            pair.normal = wp.where(wp.dot(flat, core.center - solid.size) < 0.0, -1.0, 1.0) * flat
        pair.point -= own.radius * pair.normal
        return pair

    return nearest_pair


@cache
def _make_push(*, cores: bool) -> wp.Function:
    @wp.func
    def push(shape: Shape, own: BodyShape, core: Core) -> wp.vec3:
        """Return the contact normal on a shape, in the frame of the part; 0 if both are clearly apart."""
        if wp.static(cores):  # noqa: SIM102 (wp.static must be the whole condition)
            if own.reach > own.radius:
                limit = own.radius + 2.0 * NEAR + 2.0 * EDGE * (own.reach + shape.radius)
                hit = nearest_of_core(shape, core, limit)
                return wp.where(hit.distance < limit, 1.0, 0.0) * hit.normal
        if signed_distance(shape, core.center) < own.radius + 2.0 * NEAR:
            return outward_normal(shape, core.center)
        return wp.vec3()

    return push


@cache
def make_first_crossing(*, moves: bool, cores: bool, meshes: bool) -> wp.Function:
    """Return the search along one path; whether obstacles move, the robot has boxes or capsules, and any part is a mesh."""
    touch_time = make_touch_time(cores=cores)
    nearest_pair, push_on = _make_nearest_pair(cores=cores), _make_push(cores=cores)
    obstacles_type: Any = Obstacles if moves else int

    @wp.func
    def earlier_crossing(
        solid: Shape,
        shape: Shape,
        other: Path,
        own: BodyShape,
        path: Path,
        done: Substep,
        spin: wp.vec3,
        lin_vel: wp.vec3,
        least_approach: float,
        before: wp.vec4,
        push: wp.vec4,
        hit: Crossing,
    ):
        """Return the earlier of the given crossing and that of a part or face, and whether it is a crash.

        ``before`` and ``push`` hold the contact normal at the start and at the end, with 1 as fourth entry once known; both
        are returned. A shape that starts inside a mesh counts as on the side of its contact normal.
        """
        t = touch_time(solid, other, own, path, 0.0, wp.min(hit.time, 1.0))
        if t == wp.inf:
            return hit, wp.bool(False), before, push
        core = _transform_core(shape, other, own, path, t)
        pair = nearest_pair(solid, own, core)
        local = pair.normal
        overlaps = solid.kind == TRIANGLE and pair.distance < own.radius
        if overlaps:
            if before[3] == 0.0:
                direction = push_on(shape, own, core)
                before = wp.vec4(direction[0], direction[1], direction[2], 1.0)
            if wp.length(wp.vec3(before[0], before[1], before[2])) > 0.0:
                local = wp.vec3(before[0], before[1], before[2])
        turn = path_attitude(other, t) * shape.attitude
        normal = wp.quat_rotate(turn, local)
        from_carrier = wp.quat_rotate(turn, pair.point) + wp.quat_rotate(path_attitude(other, t), shape.position)
        surface_vel = lin_vel + wp.cross(spin, from_carrier)
        arm = other.start + t * other.shift + from_carrier - path.start - t * path.shift
        approach = wp.dot(
            normal,
            surface_vel - point_velocity(done.first_lin_vel, rotate(done.first_attitude, done.first_ang_vel), arm),
        )
        crashes = approach >= least_approach
        reach = own.radius + _core_depth(core, local)
        surface = support(solid, local)
        if overlaps:
            surface = wp.dot(local, core.center) - reach - (pair.distance - own.radius)
        floor = wp.min(wp.dot(local, core.center) - reach - surface, 0.0)
        end = _transform_core(shape, other, own, path, 1.0)
        reach = own.radius + _core_depth(end, local)
        gap = wp.dot(local, end.center) - reach - surface
        if gap >= floor:
            return hit, crashes, before, push
        if push[3] == 0.0:
            direction = push_on(shape, own, end)
            push = wp.vec4(direction[0], direction[1], direction[2], 1.0)
        if wp.dot(wp.vec3(push[0], push[1], push[2]), local) > 0.0:
            return hit, crashes, before, push
        turn = path_attitude(other, 1.0) * shape.attitude
        hit.time = t
        hit.normal = wp.quat_rotate(turn, local)
        hit.gap = gap
        hit.floor = floor
        hit.surface_vel = surface_vel
        hit.lever = wp.quat_rotate(path_attitude(path, 1.0), wp.quat_rotate_inv(path_attitude(path, t), arm))
        return hit, crashes, before, push

    @wp.func
    def earlier_part_crossing(
        shape: Shape,
        other: Path,
        own: BodyShape,
        path: Path,
        done: Substep,
        spin: wp.vec3,
        lin_vel: wp.vec3,
        least_approach: float,
        hit: Crossing,
    ):
        """Return the earlier of two crossings as ``earlier_crossing`` does, for a part; of a mesh, over all its faces."""
        solid = shape
        crashes = wp.bool(False)
        before = wp.vec4()
        push = wp.vec4()
        face = wp.int32(0)
        is_mesh = wp.static(meshes) and shape.kind == MESH
        if wp.static(meshes):  # noqa: SIM102 (wp.static must be the whole condition)
            if is_mesh:
                middle, half = sweep_bounds(shape, other, own, path, 0.0, 1.0)
                query = wp.mesh_query_aabb(shape.mesh, middle - half, middle + half)
        more = wp.bool(True)
        while more:
            if wp.static(meshes):  # noqa: SIM102 (wp.static must be the whole condition)
                if is_mesh:
                    more = wp.mesh_query_aabb_next(query, face)
                    if more:
                        solid = face_shape(shape, face)
            if more:
                hit, fast, before, push = earlier_crossing(
                    solid, shape, other, own, path, done, spin, lin_vel, least_approach, before, push, hit
                )
                crashes = crashes or fast
            more = more and is_mesh
        return hit, crashes

    @wp.func
    def first_crossing(
        scene: SceneArrays,
        motion: SceneMotion,
        obstacles: obstacles_type,
        sphere: wp.array[wp.vec4],
        body: wp.array[BodyShape],
        least_approach: float,
        env: int,
        done: Substep,
        path: Path,
        hull: float,
    ):
        """Return the first crossing of a path, and whether anything is touched at the speed of a crash."""
        hit = Crossing()
        hit.time = wp.inf
        crashes = wp.bool(False)
        end = path.start + path.shift
        part = wp.int32(0)
        while part < scene.num_solid:
            row = scene.part_shape[env, part]
            a = scene.part_instance[env, part]
            is_there = row >= 0 and a >= 0
            other = Path()
            lin_vel = wp.vec3()
            spin = wp.vec3()
            if is_there:
                x = scene.position[env, a]
                q = scene.attitude[env, a]
                is_there = x[2] > ABSENT_BELOW
                other.start = x
                other.attitude = q
                lin_vel = motion.lin_vel[env, a]
                spin = motion.ang_vel[env, a]
                if wp.static(moves):  # noqa: SIM102 (wp.static must be the whole condition)
                    if is_there and instance_moves(obstacles, env, a):
                        to, _q, _v = advance_pose(obstacles, env, a, x, q, lin_vel, done.dt)
                        if next_reversal(obstacles, env, a, x, lin_vel, done.dt, 0.0) < 1.0:
                            other.start = to
                        else:
                            other.shift = to - x
                            other.turn = done.dt * obstacles.ang_vel[env, a]
            if is_there:
                shape = scene.shapes[row]
                way = wp.length(path.shift - other.shift)
                near = scene.radius[env, part] + hull + wp.length(shape.position) * wp.min(wp.length(other.turn), 2.0)
                origin = other.start + other.shift + wp.quat_rotate(other.attitude, shape.position)
                if wp.length(end - origin) < near + way + NEAR:
                    c = wp.int32(0)
                    while c < sphere.shape[0]:
                        point = as_body_shape(sphere[c])
                        hit, fast = earlier_part_crossing(
                            shape, other, point, path, done, spin, lin_vel, least_approach, hit
                        )
                        crashes = crashes or fast
                        c += 1
                    if wp.static(cores):
                        c = wp.int32(0)
                        while c < body.shape[0]:
                            hit, fast = earlier_part_crossing(
                                shape, other, body[c], path, done, spin, lin_vel, least_approach, hit
                            )
                            crashes = crashes or fast
                            c += 1
            part += 1
        return hit, crashes

    return first_crossing


@cache
def make_find_stop(*, moves: bool, cores: bool, meshes: bool) -> wp.Function:
    """Return the search for the place where a robot stops, with the same choices."""
    first_crossing = make_first_crossing(moves=moves, cores=cores, meshes=meshes)
    obstacles_type: Any = Obstacles if moves else int

    @wp.func
    def find_stop(
        scene: SceneArrays,
        motion: SceneMotion,
        obstacles: obstacles_type,
        sphere: wp.array[wp.vec4],
        body: wp.array[BodyShape],
        hull: float,
        least_approach: float,
        env: int,
        done: Substep,
    ) -> CrossingStop:
        """Return the pose at which obstacles stop the robot; they stand as before the substep.

        ``hull`` is the radius [m] of a ball about the robot's origin that holds its shapes.
        """
        stop = CrossingStop()
        stop.position = done.position
        stop.attitude = done.attitude
        path = substep_path(done)
        whole = path.shift
        shift = wp.vec3()
        floors = wp.vec4()
        count = wp.int32(0)
        clear = wp.bool(False)
        while count < ROUNDS and not clear:
            path.shift = whole + shift
            hit, crashes = first_crossing(
                scene, motion, obstacles, sphere, body, least_approach, env, done, path, hull + wp.length(done.com)
            )
            stop.crashes = stop.crashes or crashes
            clear = hit.time == wp.inf
            if not clear:
                stop.crosses = True
                stop.pairs.gaps[count] = hit.gap - wp.dot(hit.normal, shift)
                stop.pairs.levers[count] = hit.lever
                stop.pairs.normals[count] = hit.normal
                stop.pairs.surface_vels[count] = hit.surface_vel
                floors[count] = hit.floor
                count += 1
                shift = _lift_shift(stop.pairs, floors, count, shift)
        stop.position += shift
        if not clear:
            stop.position = done.first_position
            stop.attitude = done.first_attitude
        return stop

    return find_stop
