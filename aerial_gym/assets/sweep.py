"""Continuous collision detection: contact of a robot's shape with a part between two poses of a step.

Between the poses, one point of each body, its pivot, moves along a straight line, and the body turns about it at a constant
rate. The search is conservative advancement. At each instant, the nearest pair of robot shape and part gives a plane between
them that supports the part. No corner of the shape's core can reach the plane before the root of ``h = u t + a t²/2``. Here h
is its height, u its speed towards the plane and a a bound of its acceleration, relative to the part. The search continues
there.

Parts are convex, so the plane bounds the whole part; of a mesh, each face near the motion is swept as a separate part. The
search reports a contact if it comes nearer than ``NEAR`` during an approach, or needs more than ``MAX_STEPS`` instants. Real
contacts are therefore never missed. A pass at a distance above ``NEAR`` (and 6e-5 of an edge of the part) is clear.
Sources: Mirtich (1996), Impulse-based Dynamic Simulation of Rigid Body Systems, PhD thesis, Berkeley (conservative
advancement); Zhang, Lee, Kim (2006), Interactive continuous collision detection for non-convex polyhedra, The Visual Computer
22 (bounds of the motion along the direction of the nearest pair).
Letters: C shapes of the robot. Time runs from 0 to 1 between the two poses; displacements and rotations are those of this span.
"""

from functools import cache

import warp as wp

from aerial_gym.assets.body_shapes import BodyShape
from aerial_gym.assets.geometry import extent_in_direction, primitive_distance, primitive_normal
from aerial_gym.assets.nearest import BISECTIONS, Core, box_corner, nearest_of_core, repeats_corner
from aerial_gym.assets.obstacle_motion import advance_pose, next_reversal
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene_arrays import BOX, MESH, TRIANGLE, Shape

NEAR = wp.constant(2.0e-4)  # Distance of a contact between poses [m]; at 1 km, float32 rounds positions by 6e-5 m
MAX_STEPS = 64  # Evaluations before a contact is assumed, two at each instant. Of 3,600 passes at 0.5 mm all took <= 20
EDGE = wp.constant(0.5 ** int(BISECTIONS))  # Accuracy of a part's nearest point to a box, as a share of half an edge


@wp.struct
class Path:
    """The motion of a body between two poses."""

    pivot: wp.vec3  # point that moves along a line, frame of the body [m]
    start: wp.vec3  # where it is at time 0, world [m]
    shift: wp.vec3  # its displacement [m]
    attitude: wp.quat  # body to world at time 0, xyzw
    turn: wp.vec3  # rotation vector, world [rad]


@wp.func
def make_path(pivot: wp.vec3, x0: wp.vec3, q0: wp.quat, x1: wp.vec3, q1: wp.quat) -> Path:
    """Return the motion between two poses of a body's origin, with the shorter rotation."""
    start = x0 + wp.quat_rotate(q0, pivot)
    turned = q1 * wp.quat_inverse(q0)
    axis = wp.vec3(turned[0], turned[1], turned[2])
    half = wp.length(axis)
    angle = 2.0 * wp.atan2(half, wp.abs(turned[3]))
    turn = wp.where(half > 0.0, wp.where(turned[3] < 0.0, -angle, angle) / wp.max(half, 1.0e-20), 2.0) * axis
    return Path(pivot, start, x1 + wp.quat_rotate(q1, pivot) - start, q0, turn)


@wp.func
def relative_sagitta(q0: wp.quat, q1: wp.quat) -> float:
    """Return the sagitta of a point's arc between two attitudes, divided by its lever arm: ``1 - cos(angle / 2)``."""
    return 1.0 - wp.abs(wp.dot(q0, q1))


@wp.func
def path_attitude(path: Path, t: float) -> wp.quat:
    """Return the attitude on a path at time t, body to world, xyzw."""
    return wp.quat_from_axis_angle(wp.normalize(path.turn), t * wp.length(path.turn)) * path.attitude


@wp.func
def time_to_plane(height: float, speed: float, acc: float) -> float:
    """Return the earliest time at which a point may reach a plane: the root of ``height = speed t + acc t²/2``, or inf."""
    root = wp.sqrt(speed * speed + 2.0 * acc * height)
    if speed > 0.0:
        return 2.0 * height / (speed + root)
    return wp.where(acc > 0.0, (root - speed) / wp.max(acc, 1.0e-20), wp.inf)


@wp.func
def as_body_shape(own: BodyShape) -> BodyShape:  # pyright: ignore[reportRedeclaration] (likewise)
    """Return a ``BodyShape`` unchanged."""
    return own


@wp.func
def as_body_shape(own: wp.vec4) -> BodyShape:  # noqa: F811 (Warp tells functions of one name by their arguments)
    """Return a sphere by centre in the body frame and radius [m]."""
    return BodyShape(wp.vec3(own[0], own[1], own[2]), wp.quat_identity(), wp.vec3(), own[3], own[3])


@wp.func
def _time_of_corner(
    path: Path, other: Path, lever: wp.vec3, away: wp.vec3, span: float, outward: wp.vec3, surface: float, slack: float
) -> float:
    """Return a lower bound of the time until a corner reaches a plane that turns with the part; 0 from below it.

    ``lever`` leads from the pivot to the corner, ``away`` from the other pivot to the pivot. ``span`` is the largest distance
    of the corner from the other pivot. The plane is where ``outward . (lever) = surface`` at present. All world [m].
    """
    height = wp.dot(outward, lever) - surface
    if height < -0.25 * slack:
        return 0.0
    drift = path.shift - other.shift
    sweep = wp.cross(path.turn, lever)
    speed = -wp.dot(outward, drift + sweep - wp.cross(other.turn, away + lever))
    other_spin = wp.length(other.turn)
    bend = wp.length(wp.cross(outward, path.turn)) + wp.length(path.turn) * other_spin
    apparent = other_spin * (2.0 * (wp.length(drift) + wp.length(sweep)) + other_spin * span)
    safe = wp.max(height - 0.5 * slack, 0.5 * wp.max(height, 0.0))  # the rest is a margin for rounding
    return time_to_plane(safe, speed, bend * wp.length(sweep) + apparent)


@cache
def make_touch_time(*, cores: bool) -> wp.Function:
    """Return the search for contact of one robot shape with a part that is no mesh; ``cores``: for boxes and capsules too."""
    num_corners = 8 if cores else 1

    @wp.func
    def touch_time(shape: Shape, other: Path, own: BodyShape, path: Path, first: float, last: float) -> float:
        """Return the time of the first contact between two times, or inf; the part's carrier follows ``other``."""
        drift = path.shift - other.shift
        t = wp.float32(first)
        k = wp.int32(0)
        by_center = wp.bool(True)  # the plane from the centre is cheap, and nearly always shows that the part is far
        while k < wp.static(MAX_STEPS):
            k += 1
            q = path_attitude(path, t)
            turn = path_attitude(other, t)
            arm = wp.quat_rotate(q, own.center - path.pivot)
            away = path.start - other.start + t * drift
            to_part = wp.quat_rotate(turn, shape.position - other.pivot)
            turn = turn * shape.attitude
            local = wp.quat_rotate_inv(turn, away + arm - to_part)
            distance = primitive_distance(shape, local)
            left = last - t
            lever = wp.length(arm) + own.reach
            span = wp.length(away) + lever + left * wp.length(drift)
            speed = wp.length(drift) + wp.length(path.turn) * lever + wp.length(other.turn) * span
            if distance - own.reach - NEAR > left * speed:
                return wp.inf
            normal = primitive_normal(shape, local)
            slack = wp.float32(NEAR)
            is_refined = own.reach == own.radius or not by_center
            if wp.static(cores):  # noqa: SIM102 (only what stands alone is static)
                if own.reach > own.radius and not by_center:
                    core = Core(local, wp.quat_inverse(turn) * q * own.attitude, own.half)
                    pair = nearest_of_core(shape, core, distance)
                    if pair.distance < distance:
                        distance = pair.distance
                        normal = pair.normal
                    slack += EDGE * own.reach
                    if wp.min(own.half) > 0.0 and shape.kind == BOX:
                        slack += EDGE * shape.radius
            distance -= own.radius
            if distance < 0.0:
                return t
            outward = wp.quat_rotate(turn, normal)
            surface = extent_in_direction(shape, normal) + wp.dot(outward, to_part - away) + own.radius
            wait = wp.where(is_refined, wp.max(distance - 0.5 * slack, 0.0) / wp.max(speed, 1.0e-20), 0.0)
            soonest = wp.float32(wp.inf)
            c = wp.int32(0)
            while c < wp.static(num_corners):
                if not repeats_corner(own.half, c):
                    corner = arm + wp.quat_rotate(q, wp.quat_rotate(own.attitude, box_corner(own.half, c)))
                    at = _time_of_corner(path, other, corner, away, span, outward, surface, slack)
                    soonest = wp.min(soonest, at)
                c += 1
            wait = wp.max(wait, soonest)
            if wait >= left:
                return wp.inf
            if is_refined:
                if distance < slack:
                    return t
                t += wait
            by_center = is_refined
        return t

    return touch_time


@wp.func
def local_center(shape: Shape, other: Path, own: BodyShape, path: Path, t: float) -> wp.vec3:
    """Return the centre of the robot's shape in the frame of the part at a time [m]."""
    q = path_attitude(other, t)
    center = path.start + t * path.shift + wp.quat_rotate(path_attitude(path, t), own.center - path.pivot)
    origin = other.start + t * other.shift + wp.quat_rotate(q, shape.position - other.pivot)
    return wp.quat_rotate_inv(q * shape.attitude, center - origin)


@wp.func
def sweep_bounds(shape: Shape, other: Path, own: BodyShape, path: Path, first: float, last: float):
    """Return centre and half edges of a bounding box of the robot shape's motion between two times, in a mesh's frame [m]."""
    a = local_center(shape, other, own, path, first)
    b = local_center(shape, other, own, path, last)
    arm = wp.length(own.center - path.pivot)
    drift = wp.length(path.shift - other.shift)
    spin = wp.length(path.turn)
    other_spin = wp.length(other.turn)
    away = wp.length(path.start - other.start) + drift + arm
    acc = spin * spin * arm + other_spin * (2.0 * (drift + spin * arm) + other_spin * away)
    edge = own.reach + NEAR + 0.125 * acc * (last - first) * (last - first)
    return 0.5 * (a + b), 0.5 * wp.abs(b - a) + wp.vec3(edge, edge, edge)


@wp.func
def face_shape(shape: Shape, face: int) -> Shape:
    """Return one face of a mesh as a shape of its own."""
    solid = shape
    solid.kind = TRIANGLE
    solid.size = wp.mesh_get_point(shape.mesh, 3 * face)
    solid.center = wp.mesh_get_point(shape.mesh, 3 * face + 1)
    solid.half = wp.mesh_get_point(shape.mesh, 3 * face + 2)
    return solid


@cache
def make_touches(*, cores: bool, meshes: bool) -> wp.Function:
    """Return the contact test against any part, meshes face by face; ``meshes``: whether any part is a mesh."""
    touch_time = make_touch_time(cores=cores)

    @wp.func
    def touches_solid(shape: Shape, other: Path, own: BodyShape, path: Path, first: float, last: float) -> wp.bool:
        """Return whether they touch between two times."""
        return touch_time(shape, other, own, path, first, last) < wp.inf

    if not meshes:
        return touches_solid

    @wp.func
    def touches(shape: Shape, other: Path, own: BodyShape, path: Path, first: float, last: float) -> wp.bool:
        """Return whether they touch between two times."""
        solid = shape
        face = wp.int32(0)
        is_mesh = shape.kind == MESH
        if is_mesh:
            middle, half = sweep_bounds(shape, other, own, path, first, last)
            query = wp.mesh_query_aabb(shape.mesh, middle - half, middle + half)
        more = wp.bool(True)
        while more:
            if is_mesh:
                more = wp.mesh_query_aabb_next(query, face)
                if more:
                    solid = face_shape(shape, face)
            if more and touches_solid(solid, other, own, path, first, last):
                return True
            more = more and is_mesh
        return False

    return touches


@cache
def make_static_sweep(*, cores: bool, meshes: bool) -> wp.Function:
    """Return the sweep of a robot's shapes against a part at rest over a step."""
    touches, body_type = make_touches(cores=cores, meshes=meshes), wp.array[BodyShape] if cores else wp.array[wp.vec4]

    @wp.func
    def touches_static(
        shape: Shape, x: wp.vec3, q: wp.quat, radius: float, body: body_type, hull: float, pivot: wp.vec3,
        position: wp.array2d[wp.vec3], attitude: wp.array2d[wp.quat], own: int,
    ) -> wp.bool:  # fmt: skip
        """Return whether a shape touches the part of a carrier at pose (x, q) between any two consecutive poses.

        ``radius`` [m] bounds the part about its origin, ``hull`` the robot about the body's.
        """
        other = Path(wp.vec3(), x, wp.vec3(), q, wp.vec3())
        origin = x + wp.quat_rotate(q, shape.position)
        k = wp.int32(0)
        while k + 1 < position.shape[0]:
            p = position[k, own]
            end = position[k + 1, own]
            bow = wp.length(pivot) * relative_sagitta(attitude[k, own], attitude[k + 1, own])
            if wp.length(end - origin) - radius - hull < wp.length(end - p) + bow + NEAR:
                path = make_path(pivot, p, attitude[k, own], end, attitude[k + 1, own])
                c = wp.int32(0)
                while c < body.shape[0]:
                    if touches(shape, other, as_body_shape(body[c]), path, 0.0, 1.0):
                        return True
                    c += 1
            k += 1
        return False

    return touches_static


@cache
def make_moving_sweep(*, cores: bool, meshes: bool) -> wp.Function:
    """Return the sweep of a robot's shapes against a moving part over one substep."""
    touches, body_type = make_touches(cores=cores, meshes=meshes), wp.array[BodyShape] if cores else wp.array[wp.vec4]

    @wp.func
    def touches_moving(
        obstacles: Obstacles, env: int, a: int, x: wp.vec3, q: wp.quat, v: wp.vec3, dt: float, shape: Shape,
        radius: float, body: body_type, hull: float, path: Path,
    ) -> wp.bool:  # fmt: skip
        """Return whether a shape touches the part; its carrier, instance a, starts at pose (x, q) with velocity v.

        The carrier moves in a straight line between the times of its reversals and wraps.
        """
        first = wp.float32(0.0)
        while first < 1.0:
            last = next_reversal(obstacles, env, a, x, v, dt, first)
            quarter = 0.25 * (last - first)
            early, _q, _v = advance_pose(obstacles, env, a, x, q, v, dt * (first + quarter))
            late, _q, _v = advance_pose(obstacles, env, a, x, q, v, dt * (last - quarter))
            shift = (late - early) / wp.max(2.0 * quarter, 1.0e-20)
            start = early - (first + quarter) * shift
            other = Path(wp.vec3(), start, shift, q, dt * obstacles.ang_vel[env, a])
            away = path.start - other.start + last * (path.shift - other.shift)
            room = radius + wp.length(shape.position) + hull + wp.length(path.pivot) + NEAR
            if wp.length(away) - room < (last - first) * wp.length(path.shift - other.shift):
                c = wp.int32(0)
                while c < body.shape[0]:
                    if touches(shape, other, as_body_shape(body[c]), path, first, last):
                        return True
                    c += 1
            first = last
        return False

    return touches_moving
