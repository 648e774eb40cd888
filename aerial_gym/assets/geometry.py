"""Ray intersections with shapes and signed distances to shapes, as Warp functions of ray caster and collision test.

Everything here is in the shape's own frame: centred on the origin, axis of symmetry along z. Along a ray ``o + t d`` with d
of any length a convex solid is one interval ``(near, far)`` of t, which is empty if ``near > far`` and may begin behind the
origin; shapes are built by intersecting or joining such intervals. Because d may have any length, a frame may be scaled by
axis: in the frame of its bounding box every box is a cube, every sphere and cylinder has radius 1, and t stays the distance.
"""

import warp as wp

from aerial_gym.assets.scene_arrays import BOX, CAPSULE, CYLINDER, MESH, PLANE, SPHERE, TRIANGLE, Shape

TINY = wp.constant(1.0e-20)  # Replaces a direction component of 0, so that its reciprocal stays finite


@wp.func
def slab_interval(origin: float, direction: float, half: float) -> wp.vec2:
    """Return the interval in which ``|origin + t direction| <= half``."""
    inverse = 1.0 / wp.where(wp.abs(direction) > TINY, direction, TINY)
    a = (-half - origin) * inverse
    b = (half - origin) * inverse
    return wp.vec2(wp.min(a, b), wp.max(a, b))


@wp.func
def box_interval(origin: wp.vec3, direction: wp.vec3, half: wp.vec3) -> wp.vec2:
    """Return the interval inside a box: where the three slabs overlap."""
    x = slab_interval(origin[0], direction[0], half[0])
    y = slab_interval(origin[1], direction[1], half[1])
    z = slab_interval(origin[2], direction[2], half[2])
    return wp.vec2(wp.max(wp.max(x[0], y[0]), z[0]), wp.min(wp.min(x[1], y[1]), z[1]))


@wp.func
def sphere_interval(origin: wp.vec3, direction: wp.vec3, radius: float) -> wp.vec2:
    """Return the interval inside a sphere about the origin.

    Source: Haines et al. (2019), Ray Tracing Gems, chapter 7: the squared distance of the line is taken from the vector to
    its nearest point, which does not cancel for small spheres far away.
    """
    across = wp.max(wp.dot(direction, direction), TINY)
    middle = -wp.dot(origin, direction) / across
    nearest = origin + middle * direction
    square = radius * radius - wp.dot(nearest, nearest)
    if square < 0.0:
        return wp.vec2(wp.inf, -wp.inf)
    half = wp.sqrt(square / across)
    return wp.vec2(middle - half, middle + half)


@wp.func
def cylinder_interval(origin: wp.vec3, direction: wp.vec3, radius: float, half_height: float) -> wp.vec2:
    """Return the interval inside a capped cylinder: the slab in z and the disc in x, y, as for the sphere."""
    slab = slab_interval(origin[2], direction[2], half_height)
    across = wp.max(direction[0] * direction[0] + direction[1] * direction[1], TINY)
    middle = -(origin[0] * direction[0] + origin[1] * direction[1]) / across
    x = origin[0] + middle * direction[0]
    y = origin[1] + middle * direction[1]
    square = radius * radius - x * x - y * y
    if square < 0.0:
        return wp.vec2(wp.inf, -wp.inf)
    half = wp.sqrt(square / across)
    return wp.vec2(wp.max(slab[0], middle - half), wp.min(slab[1], middle + half))


@wp.func
def capsule_interval(origin: wp.vec3, direction: wp.vec3, radius: float, half_height: float) -> wp.vec2:
    """Return the interval inside a capsule: a cylinder and two spheres, joined.

    A capsule is convex, so what its parts cover along a line is one interval, from the first entry to the last exit.
    """
    up = wp.vec3(0.0, 0.0, half_height)
    body = cylinder_interval(origin, direction, radius, half_height)
    top = sphere_interval(origin - up, direction, radius)
    bottom = sphere_interval(origin + up, direction, radius)
    near = float(wp.inf)
    far = float(-wp.inf)
    if body[0] <= body[1]:
        near = body[0]
        far = body[1]
    return wp.vec2(wp.min(near, wp.min(top[0], bottom[0])), wp.max(far, wp.max(top[1], bottom[1])))


@wp.func
def distance_to_first_surface(inside: wp.vec2, limit: float) -> float:
    """Return t at the first surface of an interval, at most ``limit``; a ray from inside a solid ends at its exit."""
    first = wp.where(inside[0] >= 0.0, inside[0], inside[1])
    return wp.where(inside[0] <= inside[1] and first >= 0.0, wp.min(first, limit), limit)


@wp.func
def ray_distance_to_unit_shape(kind: int, origin: wp.vec3, direction: wp.vec3, limit: float) -> float:
    """Return t at the first surface of a BOX, SPHERE or CYLINDER in the frame of its bounding box, at most ``limit``."""
    if kind == SPHERE:
        return distance_to_first_surface(sphere_interval(origin, direction, 1.0), limit)
    if kind == CYLINDER:
        return distance_to_first_surface(cylinder_interval(origin, direction, 1.0, 1.0), limit)
    return distance_to_first_surface(box_interval(origin, direction, wp.vec3(1.0, 1.0, 1.0)), limit)


@wp.func
def ray_distance_to_other_shape(shape: Shape, origin: wp.vec3, direction: wp.vec3, limit: float) -> float:
    """Return t at the first surface of a CAPSULE, MESH or PLANE in the frame of its bounding box, at most ``limit``."""
    if shape.kind == PLANE:
        fall = wp.where(wp.abs(direction[2]) > TINY, direction[2], TINY)
        t = -origin[2] / fall
        return wp.where(t >= 0.0 and t < limit, t, limit)
    own, along = wp.cw_mul(origin, shape.half) + shape.center, wp.cw_mul(direction, shape.half)
    if shape.kind == CAPSULE:
        return distance_to_first_surface(capsule_interval(own, along, shape.size[0], shape.size[1]), limit)
    bounds = box_interval(origin, direction, wp.vec3(1.0, 1.0, 1.0))
    if bounds[0] > bounds[1] or bounds[1] < 0.0 or bounds[0] >= limit:
        return limit
    query = wp.mesh_query_ray(shape.ray_mesh, own, along, limit)
    return wp.where(query.result, query.t, limit)


@wp.func
def box_distance(point: wp.vec3, half: wp.vec3) -> float:
    """Return the signed distance of a point to a box [m]."""
    x = wp.abs(point[0]) - half[0]
    y = wp.abs(point[1]) - half[1]
    z = wp.abs(point[2]) - half[2]
    outside = wp.length(wp.vec3(wp.max(x, 0.0), wp.max(y, 0.0), wp.max(z, 0.0)))
    return outside + wp.min(wp.max(x, wp.max(y, z)), 0.0)


@wp.func
def cylinder_distance(point: wp.vec3, radius: float, half_height: float) -> float:
    """Return the signed distance of a point to a capped cylinder [m]: a box in the half plane (radius, z)."""
    across = wp.sqrt(point[0] * point[0] + point[1] * point[1]) - radius
    along = wp.abs(point[2]) - half_height
    outside = wp.length(wp.vec2(wp.max(across, 0.0), wp.max(along, 0.0)))
    return outside + wp.min(wp.max(across, along), 0.0)


@wp.func
def capsule_distance(point: wp.vec3, radius: float, half_height: float) -> float:
    """Return the signed distance of a point to a capsule [m]: to its middle segment, less the radius."""
    along = wp.clamp(point[2], -half_height, half_height)
    return wp.length(wp.vec3(point[0], point[1], point[2] - along)) - radius


@wp.func
def _nearest_on_line(point: wp.vec3, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Return the nearest point of the segment from a to b."""
    along = b - a
    share = wp.dot(point - a, along) / wp.max(wp.dot(along, along), TINY)
    return a + wp.clamp(share, 0.0, 1.0) * along


@wp.func
def nearest_on_triangle(point: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Return the nearest point of a triangle: the projection if that is inside, else a point of an edge."""
    normal = wp.cross(b - a, c - a)
    square = wp.dot(normal, normal)
    ab = wp.dot(wp.cross(b - a, point - a), normal)
    bc = wp.dot(wp.cross(c - b, point - b), normal)
    ca = wp.dot(wp.cross(a - c, point - c), normal)
    if square > 0.0 and wp.min(ab, wp.min(bc, ca)) >= 0.0:
        return point - (wp.dot(point - a, normal) / square) * normal
    nearest = _nearest_on_line(point, a, b)
    second = _nearest_on_line(point, b, c)
    third = _nearest_on_line(point, c, a)
    if wp.length_sq(second - point) < wp.length_sq(nearest - point):
        nearest = second
    if wp.length_sq(third - point) < wp.length_sq(nearest - point):
        nearest = third
    return nearest


@wp.func
def mesh_distance(mesh: wp.uint64, point: wp.vec3, reach: float) -> float:
    """Return the signed distance of a point to a mesh [m], at most ``reach``.

    Inside is where the winding number is above 1/2, so an open sheet has no inside. Source: Barill et al. (2018), Fast
    winding numbers for soups and clouds.
    """
    query = wp.mesh_query_point_sign_winding_number(mesh, point, reach)
    if not query.result:
        return reach
    closest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    return query.sign * wp.length(point - closest)


@wp.func
def primitive_distance(shape: Shape, point: wp.vec3) -> float:
    """Return the signed distance of a point to a shape that is no mesh [m]."""
    distance = 0.0
    if shape.kind == BOX:
        distance = box_distance(point, shape.size)
    elif shape.kind == SPHERE:
        distance = wp.length(point) - shape.size[0]
    elif shape.kind == CYLINDER:
        distance = cylinder_distance(point, shape.size[0], shape.size[1])
    elif shape.kind == CAPSULE:
        distance = capsule_distance(point, shape.size[0], shape.size[1])
    elif shape.kind == PLANE:
        distance = point[2]
    elif shape.kind == TRIANGLE:
        distance = wp.length(point - nearest_on_triangle(point, shape.size, shape.center, shape.half))
    return distance


@wp.func
def extent_in_direction(shape: Shape, direction: wp.vec3) -> float:
    """Return the distance [m] from the centre to the farthest point along a unit vector, of a shape but a mesh.

    For a plane the vector must be its own normal. In geometry this is the support function.
    """
    size = shape.size
    if shape.kind == BOX:
        return wp.dot(size, wp.vec3(wp.abs(direction[0]), wp.abs(direction[1]), wp.abs(direction[2])))
    if shape.kind == TRIANGLE:
        return wp.max(wp.dot(size, direction), wp.max(wp.dot(shape.center, direction), wp.dot(shape.half, direction)))
    along = size[1] * wp.abs(direction[2])
    if shape.kind == CYLINDER:
        return along + size[0] * wp.length(wp.vec2(direction[0], direction[1]))
    if shape.kind == PLANE:
        return 0.0
    if shape.kind == SPHERE:
        return size[0]
    return along + size[0]


@wp.func
def signed_distance(shape: Shape, point: wp.vec3) -> float:
    """Return the distance of a point to the surface of a shape [m], negative inside."""
    if shape.kind == MESH:
        # upper bound of the distance to the surface; the margin keeps it strict in float32
        return mesh_distance(shape.mesh, point, 1.01 * (wp.length(point) + shape.radius))
    return primitive_distance(shape, point)


@wp.func
def outward_normal(shape: Shape, point: wp.vec3) -> wp.vec3:
    """Return the gradient of the signed distance, a unit vector: away from the nearest surface outside, towards it inside.

    With several nearest surface points, as on an axis, it is the direction of one of them.
    """
    if shape.kind == MESH:
        query = wp.mesh_query_point_sign_winding_number(shape.mesh, point, 1.01 * (wp.length(point) + shape.radius))
        away = query.sign * (point - wp.mesh_eval_position(shape.mesh, query.face, query.u, query.v))
        flat = wp.mesh_eval_face_normal(shape.mesh, query.face)  # on the surface itself
        return wp.where(wp.length(away) > 1.0e-6, wp.normalize(away), flat)
    return primitive_normal(shape, point)


@wp.func
def primitive_normal(shape: Shape, point: wp.vec3) -> wp.vec3:
    """Return the outward normal of a shape that is no mesh, as ``outward_normal`` does."""
    if shape.kind == PLANE:
        return wp.vec3(0.0, 0.0, 1.0)
    if shape.kind == TRIANGLE:
        away = point - nearest_on_triangle(point, shape.size, shape.center, shape.half)
        flat = wp.normalize(wp.cross(shape.center - shape.size, shape.half - shape.size))
        return wp.where(wp.length(away) > 0.0, wp.normalize(away), flat)
    if shape.kind == BOX:
        return _box_normal(point, shape.size)
    axis = wp.vec3(point[0], point[1], 0.0)
    across = wp.where(wp.length(axis) > 0.0, wp.normalize(axis), wp.vec3(1.0, 0.0, 0.0))
    if shape.kind == CYLINDER:
        flat = _box_normal(
            wp.vec3(wp.length(axis), 0.0, point[2]), wp.vec3(shape.size[0], shape.size[0], shape.size[1])
        )
        return flat[0] * across + wp.vec3(0.0, 0.0, flat[2])
    middle = 0.0
    if shape.kind == CAPSULE:
        middle = wp.clamp(point[2], -shape.size[1], shape.size[1])
    away = wp.vec3(point[0], point[1], point[2] - middle)
    return wp.where(wp.length(away) > 0.0, wp.normalize(away), across)


@wp.func
def _box_normal(point: wp.vec3, half: wp.vec3) -> wp.vec3:
    """Return the gradient of ``box_distance``."""
    side = wp.vec3(wp.sign(point[0]), wp.sign(point[1]), wp.sign(point[2]))
    beyond = wp.vec3(wp.abs(point[0]) - half[0], wp.abs(point[1]) - half[1], wp.abs(point[2]) - half[2])
    outside = wp.vec3(wp.max(beyond[0], 0.0), wp.max(beyond[1], 0.0), wp.max(beyond[2], 0.0))
    if wp.length(outside) > 0.0:
        return wp.cw_mul(side, wp.normalize(outside))
    nearest = wp.vec3()
    nearest[int(wp.argmax(beyond))] = 1.0
    return wp.cw_mul(side, nearest)
