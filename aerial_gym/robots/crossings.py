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
from math import cos, log, pi
from typing import Any

import warp as wp

from aerial_gym.assets.body_shapes import BodyShape
from aerial_gym.assets.geometry import (
    extent_in_direction,
    outward_normal,
    primitive_distance,
    primitive_normal,
    signed_distance,
)
from aerial_gym.assets.nearest import Core, NearestPair, nearest_of_core
from aerial_gym.assets.obstacle_motion import advance_pose, is_present_and_moves, next_reversal
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, MESH, TRIANGLE, Shape
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
from aerial_gym.robots.contact_pairs import ContactPairs, ContactScene

MAX_PLANES = 3  # Planes that fix a robot in a corner, as many as a shift has directions
ROUNDS = wp.constant(MAX_PLANES + 1)  # Most sweeps of a substep: one for each plane, and one of the clear path

CORNER_ANGLE, CORNER_REMAINDER = pi / 4.0, 1.0 / 256.0
"""Angle of a sharp corner between two planes [rad], and share of the depth that the shifts leave in it for the next sweep."""

PASSES = round(log(CORNER_REMAINDER) / (2.0 * log(cos(CORNER_ANGLE))))
"""Shifts along each normal in turn. Derived: a pass leaves ``cos² a`` of the depth in a corner of angle a."""


@wp.struct
class ShapeSweep:
    """Motion of a shape of the robot and of a part within a substep."""

    shape: Shape  # the part
    other: Path  # of the part's carrier
    lin_vel: wp.vec3  # of the carrier's origin, world [m/s]
    spin: wp.vec3  # of the carrier, world [rad/s]
    own: BodyShape
    path: Path  # of the robot


@wp.struct
class NormalsOfSubstep:
    """Contact normals on a shape in the frame of the part, with 1 as fourth entry once known."""

    before: wp.vec4  # at the start of the substep
    after: wp.vec4  # at its end


@wp.struct
class Crossing:
    """The first crossing of a substep."""

    time: float  # of the touch, as a share of the substep; inf without one
    normal: wp.vec3  # of the plane at the end of the substep, towards the robot, world
    gap: float  # of the shape at the end of the substep, from the plane [m], < 0
    floor: float  # at the touch, or 0 if that is smaller [m]
    lever: wp.vec3  # from the centre of mass to the point that touched, world [m]
    surface_vel: wp.vec3  # world [m/s]
    crashes: wp.bool  # whether anything is touched at the speed of a crash on the whole path


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
def core_at_time(sweep: ShapeSweep, t: float) -> Core:
    """Return the core of the robot's shape in the frame of the part at time t."""
    turn = wp.quat_inverse(path_attitude(sweep.other, t) * sweep.shape.attitude)
    attitude = turn * path_attitude(sweep.path, t) * sweep.own.attitude
    return Core(local_center(sweep.shape, sweep.other, sweep.own, sweep.path, t), attitude, sweep.own.half)


@wp.func
def core_extent(core: Core, normal: wp.vec3) -> float:
    """Return the half extent of a core along a direction [m], the support function of a box."""
    own = wp.quat_rotate_inv(core.turn, normal)
    return wp.dot(core.half, wp.vec3(wp.abs(own[0]), wp.abs(own[1]), wp.abs(own[2])))


@wp.func
def shift_out_of_planes(pairs: ContactPairs, floors: wp.vec4, count: int, shift: wp.vec3) -> wp.vec3:
    """Return the shift [m] that puts a robot no deeper below any of ``count`` planes than its floor."""
    for _k in range(wp.static(PASSES)):
        for i in range(count):
            deeper = floors[i] - pairs.gaps[i] - wp.dot(pairs.normals[i], shift)
            shift += wp.max(deeper, 0.0) * pairs.normals[i]
    return shift


@cache
def _make_nearest_pair(*, cores: bool) -> wp.Function:
    @wp.func
    def nearest_pair(solid: Shape, own: BodyShape, core: Core) -> NearestPair:
        """Return the nearest pair of a part, or of a face, and a shape that touches it; the point is on the shape."""
        pair = NearestPair(primitive_distance(solid, core.center), core.center, primitive_normal(solid, core.center))
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
def _make_contact_normal(*, cores: bool) -> wp.Function:
    @wp.func
    def contact_normal(shape: Shape, own: BodyShape, core: Core) -> wp.vec3:
        """Return the contact normal on a shape, in the frame of the part; 0 if both are clearly apart."""
        if wp.static(cores):  # noqa: SIM102 (wp.static must be the whole condition)
            if own.reach > own.radius:
                limit = own.radius + 2.0 * NEAR + 2.0 * EDGE * (own.reach + shape.radius)
                hit = nearest_of_core(shape, core, limit)
                return wp.where(hit.distance < limit, 1.0, 0.0) * hit.normal
        if signed_distance(shape, core.center) < own.radius + 2.0 * NEAR:
            return outward_normal(shape, core.center)
        return wp.vec3()

    return contact_normal


@cache
def _make_earlier_crossing(*, cores: bool) -> wp.Function:
    touch_time, nearest_pair = make_touch_time(cores=cores), _make_nearest_pair(cores=cores)
    contact_normal = _make_contact_normal(cores=cores)

    @wp.func
    def earlier_crossing(
        solid: Shape, sweep: ShapeSweep, done: Substep, crash_approach_speed: float, known: NormalsOfSubstep,
        hit: Crossing,
    ):  # fmt: skip
        """Return the earlier of the given crossing and that of a part or face, and the known normals.

        A shape that starts inside a mesh counts as on the side of its contact normal.
        """
        t = touch_time(solid, sweep.other, sweep.own, sweep.path, 0.0, wp.min(hit.time, 1.0))
        if t == wp.inf:
            return hit, known
        core = core_at_time(sweep, t)
        pair = nearest_pair(solid, sweep.own, core)
        local = pair.normal
        radius = sweep.own.radius
        overlaps = solid.kind == TRIANGLE and pair.distance < radius
        if overlaps:
            if known.before[3] == 0.0:
                direction = contact_normal(sweep.shape, sweep.own, core)
                known.before = wp.vec4(direction[0], direction[1], direction[2], 1.0)
            if wp.length(wp.vec3(known.before[0], known.before[1], known.before[2])) > 0.0:
                local = wp.vec3(known.before[0], known.before[1], known.before[2])
        carrier = path_attitude(sweep.other, t)
        turn = carrier * sweep.shape.attitude
        normal = wp.quat_rotate(turn, local)
        from_carrier = wp.quat_rotate(turn, pair.point) + wp.quat_rotate(carrier, sweep.shape.position)
        surface_vel = sweep.lin_vel + wp.cross(sweep.spin, from_carrier)
        arm = sweep.other.start + t * sweep.other.shift + from_carrier - sweep.path.start - t * sweep.path.shift
        own_vel = point_velocity(done.first_lin_vel, rotate(done.first_attitude, done.first_ang_vel), arm)
        hit.crashes = hit.crashes or wp.dot(normal, surface_vel - own_vel) >= crash_approach_speed
        reach = radius + core_extent(core, local)
        surface = extent_in_direction(solid, local)
        if overlaps:
            surface = wp.dot(local, core.center) - reach - (pair.distance - radius)
        floor = wp.min(wp.dot(local, core.center) - reach - surface, 0.0)
        end = core_at_time(sweep, 1.0)
        gap = wp.dot(local, end.center) - (radius + core_extent(end, local)) - surface
        if gap >= floor:
            return hit, known
        if known.after[3] == 0.0:
            direction = contact_normal(sweep.shape, sweep.own, end)
            known.after = wp.vec4(direction[0], direction[1], direction[2], 1.0)
        if wp.dot(wp.vec3(known.after[0], known.after[1], known.after[2]), local) > 0.0:
            return hit, known
        hit.time = t
        hit.normal = wp.quat_rotate(path_attitude(sweep.other, 1.0) * sweep.shape.attitude, local)
        hit.gap = gap
        hit.floor = floor
        hit.surface_vel = surface_vel
        at_touch = wp.quat_rotate_inv(path_attitude(sweep.path, t), arm)
        hit.lever = wp.quat_rotate(path_attitude(sweep.path, 1.0), at_touch)
        return hit, known

    return earlier_crossing


@cache
def _make_earlier_part_crossing(*, cores: bool, meshes: bool) -> wp.Function:
    earlier_crossing = _make_earlier_crossing(cores=cores)

    @wp.func
    def earlier_part_crossing(sweep: ShapeSweep, done: Substep, crash_approach_speed: float, hit: Crossing) -> Crossing:
        """Return the earlier of the given crossing and that of a part; of a mesh, over all its faces."""
        shape = sweep.shape
        solid = shape
        known = NormalsOfSubstep()
        face = wp.int32(0)
        is_mesh = wp.static(meshes) and shape.kind == MESH
        if wp.static(meshes):  # noqa: SIM102 (wp.static must be the whole condition)
            if is_mesh:
                middle, half = sweep_bounds(shape, sweep.other, sweep.own, sweep.path, 0.0, 1.0)
                query = wp.mesh_query_aabb(shape.mesh, middle - half, middle + half)
        more = wp.bool(True)
        while more:
            if wp.static(meshes):  # noqa: SIM102 (wp.static must be the whole condition)
                if is_mesh:
                    more = wp.mesh_query_aabb_next(query, face)
                    if more:
                        solid = face_shape(shape, face)
            if more:
                hit, known = earlier_crossing(solid, sweep, done, crash_approach_speed, known, hit)
            more = more and is_mesh
        return hit

    return earlier_part_crossing


@cache
def make_first_crossing(*, moves: bool, cores: bool, meshes: bool) -> wp.Function:
    """Return the search along one path; whether obstacles move, the robot has boxes or capsules, and any part is a mesh."""
    earlier_part_crossing = _make_earlier_part_crossing(cores=cores, meshes=meshes)
    obstacles_type: Any = Obstacles if moves else int

    @wp.func
    def first_crossing(
        around: ContactScene, obstacles: obstacles_type, crash_approach_speed: float, env: int, done: Substep,
        path: Path,
    ) -> Crossing:  # fmt: skip
        """Return the first crossing of a path; touches at ``crash_approach_speed`` [m/s] or faster are crashes."""
        scene = around.scene
        hit = Crossing()
        hit.time = wp.inf
        end = path.start + path.shift
        part = wp.int32(0)
        while part < scene.num_solid:
            row = scene.part_shape[env, part]
            a = scene.part_instance[env, part]
            is_there = row >= 0 and a >= 0
            sweep = ShapeSweep()
            if is_there:
                x = scene.position[env, a]
                q = scene.attitude[env, a]
                is_there = x[2] > ABSENT_BELOW
                sweep.other.start = x
                sweep.other.attitude = q
                sweep.lin_vel = around.lin_vel[env, a]
                sweep.spin = around.ang_vel[env, a]
                if wp.static(moves):  # noqa: SIM102 (wp.static must be the whole condition)
                    if is_there and is_present_and_moves(obstacles, env, a):
                        to, _q, _v = advance_pose(obstacles, env, a, x, q, sweep.lin_vel, done.dt)
                        if next_reversal(obstacles, env, a, x, sweep.lin_vel, done.dt, 0.0) < 1.0:
                            sweep.other.start = to
                        else:
                            sweep.other.shift = to - x
                            sweep.other.turn = done.dt * obstacles.ang_vel[env, a]
            if is_there:
                shape = scene.shapes[row]
                sweep.shape = shape
                sweep.path = path
                way = wp.length(path.shift - sweep.other.shift)
                bow = wp.length(shape.position) * wp.min(wp.length(sweep.other.turn), 2.0)
                near = scene.radius[env, part] + (around.reach + wp.length(done.com)) + bow
                origin = sweep.other.start + sweep.other.shift + wp.quat_rotate(sweep.other.attitude, shape.position)
                if wp.length(end - origin) < near + way + NEAR:
                    c = wp.int32(0)
                    while c < around.sphere.shape[0]:
                        sweep.own = as_body_shape(around.sphere[c])
                        hit = earlier_part_crossing(sweep, done, crash_approach_speed, hit)
                        c += 1
                    if wp.static(cores):
                        c = wp.int32(0)
                        while c < around.body.shape[0]:
                            sweep.own = around.body[c]
                            hit = earlier_part_crossing(sweep, done, crash_approach_speed, hit)
                            c += 1
            part += 1
        return hit

    return first_crossing


@cache
def make_stop_search(*, moves: bool, cores: bool, meshes: bool) -> wp.Function:
    """Return the search for the place where a robot stops, with the same choices."""
    first_crossing = make_first_crossing(moves=moves, cores=cores, meshes=meshes)
    obstacles_type: Any = Obstacles if moves else int

    @wp.func
    def find_stop(
        around: ContactScene, obstacles: obstacles_type, crash_approach_speed: float, env: int, done: Substep
    ) -> CrossingStop:
        """Return the pose at which obstacles stop the robot; they stand as before the substep."""
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
            hit = first_crossing(around, obstacles, crash_approach_speed, env, done, path)
            stop.crashes = stop.crashes or hit.crashes
            clear = hit.time == wp.inf
            if not clear:
                stop.crosses = True
                stop.pairs.gaps[count] = hit.gap - wp.dot(hit.normal, shift)
                stop.pairs.levers[count] = hit.lever
                stop.pairs.normals[count] = hit.normal
                stop.pairs.surface_vels[count] = hit.surface_vel
                floors[count] = hit.floor
                count += 1
                shift = shift_out_of_planes(stop.pairs, floors, count, shift)
        stop.position += shift
        if not clear:
            stop.position = done.first_position
            stop.attitude = done.first_attitude
        return stop

    return find_stop
