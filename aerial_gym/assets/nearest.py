"""The nearest pair of a core and another shape.

A core is the box, line or point that a collision shape surrounds with a radius.

For a point the signed distance is one evaluation. Otherwise the nearest pair of two shapes that are apart is searched among
their features: an edge of the core against the other shape, an edge, the axis or the rim of the other shape against the box;
corners against the triangles of a mesh, and their edges against the core. Signed distances to convex shapes are convex, so
the least one on an edge is found by bisection of its slope. The distance is therefore exact, but for ``2^-(BISECTIONS + 1)``
of an edge. Shapes that overlap have a negative distance, by the deepest of these features.
Sources: Boyd and Vandenberghe (2004), Convex Optimization, 3.2.5 (distances to convex sets); Lin and Canny (1991), A fast
algorithm for incremental distance calculation, ICRA (features of the nearest pair).
Frames: that of the other shape.
"""

import warp as wp

from aerial_gym.assets.geometry import (
    TINY,
    nearest_on_triangle,
    outward_normal,
    primitive_distance,
    primitive_normal,
    signed_distance,
)
from aerial_gym.assets.scene_arrays import BOX, CYLINDER, MESH, PLANE, TRIANGLE, Shape

BISECTIONS = wp.constant(14)  # Bisections of an edge; they locate its minimum to 3e-5 of its length


@wp.struct
class NearestPair:
    """The nearest pair of a core and another shape, in the frame of that shape."""

    distance: wp.float32  # [m], negative where they overlap
    point: wp.vec3  # of the core, or of the other shape where that is inside the core [m]
    normal: wp.vec3  # unit, towards the core


@wp.struct
class Core:
    """A core in the frame of another shape."""

    center: wp.vec3  # [m]
    turn: wp.quat  # core to that frame
    half: wp.vec3  # half edges [m]


@wp.func
def box_corner(half: wp.vec3, number: int) -> wp.vec3:
    """Return corner 0 to 7 of a box."""
    return wp.vec3(
        wp.where((number & 1) == 0, half[0], -half[0]),
        wp.where((number & 2) == 0, half[1], -half[1]),
        wp.where((number & 4) == 0, half[2], -half[2]),
    )


@wp.func
def repeats_corner(half: wp.vec3, number: int) -> wp.bool:
    """Return whether a corner repeats one with a smaller number, as in the core of a sphere or capsule."""
    x = (number & 1) != 0 and half[0] == 0.0
    y = (number & 2) != 0 and half[1] == 0.0
    z = (number & 4) != 0 and half[2] == 0.0
    return x or y or z


@wp.func
def nearer_pair(best: NearestPair, distance: float, point: wp.vec3, normal: wp.vec3) -> NearestPair:
    """Return the nearer of two pairs."""
    if distance < best.distance:
        return NearestPair(distance, point, normal)
    return best


@wp.func
def _search_edge(shape: Shape, middle: wp.vec3, half: wp.vec3, best: NearestPair) -> NearestPair:
    """Return the nearer pair: ``best``, or the nearest on the edge from ``middle - half`` to ``middle + half``."""
    if primitive_distance(shape, middle) - wp.length(half) >= best.distance:
        return best  # distances change by no more than the point moves
    low = wp.float32(-1.0)
    high = wp.float32(1.0)
    t = wp.float32(1.0)
    normal = wp.vec3()
    k = wp.int32(-2)  # both ends, the bisections, and the middle that is left; in one place, for short compile times
    while k <= BISECTIONS:
        normal = primitive_normal(shape, middle + t * half)
        slope = wp.dot(normal, half)
        if k == BISECTIONS or (k == -2 and slope <= 0.0) or (k == -1 and slope >= 0.0):
            break
        if k == -2:
            t = -1.0
        else:
            if k >= 0 and slope > 0.0:
                high = t
            else:
                low = t
            t = 0.5 * (low + high)
        k += 1
    point = middle + t * half
    return nearer_pair(best, primitive_distance(shape, point), point, normal)


@wp.func
def _search_face_and_rim(shape: Shape, core: Core, axis: int, side: float, best: NearestPair) -> NearestPair:
    """Return the nearer pair: ``best``, or that of a core's face and the deepest point of a cylinder's rim."""
    b = (axis + 1) % 3
    c = (axis + 2) % 3
    outward = wp.vec3()
    outward[axis] = side
    normal = wp.quat_rotate(core.turn, -outward)
    rim = wp.normalize(wp.vec3(normal[0], normal[1], 0.0))
    point = shape.size[0] * rim + wp.vec3(0.0, 0.0, wp.sign(normal[2]) * shape.size[1])
    inside = wp.quat_rotate_inv(core.turn, point - core.center)
    distance = side * inside[axis] - core.half[axis]
    beside = wp.max(wp.abs(inside[b]) - core.half[b], wp.abs(inside[c]) - core.half[c])
    if beside <= 0.0 and distance > -2.0 * core.half[axis]:
        return nearer_pair(best, distance, point, normal)
    return best


@wp.func
def _edge_middle(half: wp.vec3, number: int) -> wp.vec3:
    """Return the middle of edge 0 to 11 of a box; each four consecutive edges are parallel."""
    axis = number >> 2
    middle = wp.vec3()
    b = (axis + 1) % 3
    c = (axis + 2) % 3
    middle[b] = wp.where((number & 1) == 0, half[b], -half[b])
    middle[c] = wp.where((number & 2) == 0, half[c], -half[c])
    return middle


@wp.func
def _edge_half(half: wp.vec3, number: int) -> wp.vec3:
    """Return the half vector of edge 0 to 11 of a box."""
    along = wp.vec3()
    axis = number >> 2
    along[axis] = half[axis]
    return along


@wp.func
def _is_distinct_edge(half: wp.vec3, number: int) -> wp.bool:
    """Return whether edge 0 to 11 of a box has a length and, in a box without width, repeats no other."""
    axis = number >> 2
    repeats = (number & 3) > 0 and half[(axis + 1) % 3] + half[(axis + 2) % 3] == 0.0
    return half[axis] > 0.0 and not repeats


@wp.func
def _search_edges(shape: Shape, center: wp.vec3, turn: wp.quat, half: wp.vec3, best: NearestPair) -> NearestPair:
    """Return the nearer pair: ``best``, or the nearest on the edges of a box, or on its line if it has no width."""
    k = wp.int32(0)
    while k < 12:
        if _is_distinct_edge(half, k):
            middle = center + wp.quat_rotate(turn, _edge_middle(half, k))
            best = _search_edge(shape, middle, wp.quat_rotate(turn, _edge_half(half, k)), best)
        k += 1
    return best


@wp.func
def as_box(core: Core) -> Shape:
    """Return a core as a box shape."""
    box = Shape()
    box.kind = BOX
    box.size = core.half
    return box


@wp.func
def _pair_in_other_frame(core: Core, seen: NearestPair, radius: float) -> NearestPair:
    """Return a pair of the core's frame in the other shape's frame, with that shape's radius subtracted."""
    normal = -wp.quat_rotate(core.turn, seen.normal)
    point = core.center + wp.quat_rotate(core.turn, seen.point) + radius * normal
    return NearestPair(seen.distance - radius, point, normal)


@wp.func
def _search_other_edges(shape: Shape, core: Core, best: NearestPair) -> NearestPair:
    """Return the nearer pair: ``best``, or the nearest of the other shape's own edges or axis to a box.

    The axis of a cylinder counts only inside the box, where it pierces two faces far from all edges.
    """
    half = shape.size
    radius = wp.float32(0.0)
    if shape.kind != BOX:
        half = wp.vec3(0.0, 0.0, wp.max(shape.size[1], TINY))  # of a sphere nothing
        if shape.kind != CYLINDER:
            radius = shape.size[0]
    back = wp.quat_inverse(core.turn)
    seen = NearestPair()
    seen.distance = best.distance + radius
    if shape.kind == CYLINDER:
        seen.distance = wp.min(seen.distance, 0.0)
    least = seen.distance
    seen = _search_edges(as_box(core), wp.quat_rotate(back, -core.center), back, half, seen)
    if seen.distance < least:
        return _pair_in_other_frame(core, seen, radius)
    return best


PIERCED = wp.constant(1.0e-6)  # Depth [m] assigned to an edge that pierces a mesh, because an open sheet has no depth


@wp.func
def _search_corners(shape: Shape, core: Core, best: NearestPair) -> NearestPair:
    """Return the nearer pair: ``best``, or that of a mesh and the corners, centre or edges of a core."""
    nearer = wp.bool(False)
    k = wp.int32(0)
    while k < 9:
        corner = wp.where(k == 8, 0.0, 1.0) * box_corner(core.half, k)
        point = core.center + wp.quat_rotate(core.turn, corner)
        distance = signed_distance(shape, point)
        if distance < best.distance:
            best.distance = distance
            best.point = point
            nearer = True
        k += 1
    if nearer:
        best.normal = outward_normal(shape, best.point)
    k = wp.int32(0)
    while k < 12:
        edge = wp.quat_rotate(core.turn, _edge_half(core.half, k))
        length = wp.length(edge)
        if best.distance > -PIERCED and length > 0.0:
            start = core.center + wp.quat_rotate(core.turn, _edge_middle(core.half, k)) - edge
            query = wp.mesh_query_ray(shape.ray_mesh, start, edge / length, 2.0 * length)
            if query.result:
                best.distance = -PIERCED
                best.point = start + (query.t / length) * edge
                best.normal = query.normal
        k += 1
    return best


@wp.func
def _search_mesh(shape: Shape, core: Core, best: NearestPair) -> NearestPair:
    """Return the nearer pair: ``best``, or that of a mesh and a core."""
    best = _search_corners(shape, core, best)
    box = as_box(core)
    matrix = wp.quat_to_matrix(core.turn)
    extent = wp.vec3(wp.max(best.distance, 0.0), wp.max(best.distance, 0.0), wp.max(best.distance, 0.0))
    for i in range(3):
        for j in range(3):
            extent[i] = extent[i] + wp.abs(matrix[i, j]) * core.half[j]
    seen = NearestPair()
    seen.distance = best.distance
    query = wp.mesh_query_aabb(shape.mesh, core.center - extent, core.center + extent)
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        k = wp.int32(0)
        while k < 3:
            a = wp.quat_rotate_inv(core.turn, wp.mesh_get_point(shape.mesh, 3 * face + k) - core.center)
            b = wp.quat_rotate_inv(core.turn, wp.mesh_get_point(shape.mesh, 3 * face + (k + 1) % 3) - core.center)
            seen = _search_edge(box, 0.5 * (a + b), 0.5 * (b - a), seen)
            k += 1
    if seen.distance < best.distance:
        return _pair_in_other_frame(core, seen, 0.0)
    return best


@wp.func
def _nearer_point(best: NearestPair, point: wp.vec3, away: wp.vec3) -> NearestPair:
    """Return the nearer pair: ``best``, or that of a point at ``away`` from the other shape."""
    distance = wp.length(away)
    if distance > 0.0:
        return nearer_pair(best, distance, point, away / distance)
    return best


@wp.func
def _search_triangle(shape: Shape, core: Core, best: NearestPair) -> NearestPair:
    """Return the nearer pair: ``best``, or that of a triangle and a core without overlap, in closed form.

    The nearest pair of two separate polytopes has a corner of one of them, or an edge of each.
    """
    a = shape.size
    b = shape.center
    c = shape.half
    k = wp.int32(0)
    while k < 8:
        if not repeats_corner(core.half, k):
            point = core.center + wp.quat_rotate(core.turn, box_corner(core.half, k))
            best = _nearer_point(best, point, point - nearest_on_triangle(point, a, b, c))
        k += 1
    k = wp.int32(0)
    while k < 3:
        own = wp.quat_rotate_inv(core.turn, a - core.center)
        inside = wp.min(wp.max(own, -core.half), core.half)
        if wp.length_sq(own - inside) == 0.0:
            best.distance = wp.min(best.distance, -PIERCED)
        point = core.center + wp.quat_rotate(core.turn, inside)
        best = _nearer_point(best, point, point - a)
        n = wp.int32(0)
        while n < 12:
            half = wp.quat_rotate(core.turn, _edge_half(core.half, n))
            if _is_distinct_edge(core.half, n):
                middle = core.center + wp.quat_rotate(core.turn, _edge_middle(core.half, n))
                pair = wp.closest_point_edge_edge(middle - half, middle + half, a, b, 1.0e-12)
                point = middle + (2.0 * pair[0] - 1.0) * half
                best = _nearer_point(best, point, point - (a + pair[1] * (b - a)))
            n += 1
        first = a
        a = b
        b = c
        c = first
        k += 1
    return best


@wp.func
def nearest_of_core(shape: Shape, core: Core, limit: float) -> NearestPair:
    """Return the nearest pair of a core and a shape; beyond ``limit`` [m], that distance without a pair."""
    best = NearestPair()
    best.distance = limit
    if shape.kind == MESH:
        return _search_mesh(shape, core, best)
    if shape.kind == TRIANGLE:
        return _search_triangle(shape, core, best)
    best = _search_edges(shape, core.center, core.turn, core.half, best)
    if wp.min(core.half) > 0.0 and shape.kind != PLANE:
        if shape.kind == CYLINDER:
            k = wp.int32(0)
            while k < 6:
                best = _search_face_and_rim(shape, core, k >> 1, wp.where((k & 1) == 0, 1.0, -1.0), best)
                k += 1
        best = _search_other_edges(shape, core, best)
    return best
