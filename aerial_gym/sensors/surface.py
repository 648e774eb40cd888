"""Hit point of a ray on a part: normal, face and surface coordinates.

Frames: a sensor looks along its own x. Letters: E environments, M mounts (sensors of all environments), P parts.
"""

import warp as wp

from aerial_gym.assets.shape_row import BOX, CAPSULE, CYLINDER, MESH, PLANE
from aerial_gym.sensors.sensor_view import SensorView


@wp.struct
class Surface:
    """Hit point of a ray on a part."""

    normal: wp.vec3  # unit, sensor frame, towards the sensor
    face: (
        wp.int32
    )  # triangle of a mesh; box: 2 axis + (1 for the upper side); cylinder: 0 side, 1 bottom, 2 top; else 0
    place: wp.vec3  # in the frame of the bounding box
    slope: wp.vec3  # gradient of a function that is 0 on the surface and positive outside
    u: wp.float32  # weights of the corners of a triangle: u, v, 1 - u - v
    v: wp.float32


@wp.func
def hit_surface(view: SensorView, env: int, mount: int, part: int, ray: wp.vec3, distance: float) -> Surface:
    """Return normal and face where a ray meets a part.

    In the frame of the bounding box the surface is F(p) = 0 with p = A r + o; its normal in the frame of r is A^T grad F.
    """
    x = view.rows[mount, 3 * part]
    y = view.rows[mount, 3 * part + 1]
    z = view.rows[mount, 3 * part + 2]
    a = wp.vec3(x[0], x[1], x[2])
    b = wp.vec3(y[0], y[1], y[2])
    c = wp.vec3(z[0], z[1], z[2])
    seen = distance * ray
    p = wp.vec3(wp.dot(a, seen) + x[3], wp.dot(b, seen) + y[3], wp.dot(c, seen) + z[3])
    slope = p
    face = wp.int32(0)
    u = wp.float32(0.0)
    v = wp.float32(0.0)
    kind = view.kind[mount, part]
    if kind == BOX:
        size = wp.vec3(wp.abs(p[0]), wp.abs(p[1]), wp.abs(p[2]))
        axis = wp.where(size[0] >= size[1], 0, 1)
        if size[2] > size[axis]:
            axis = 2
        slope = wp.vec3(0.0, 0.0, 0.0)
        slope[axis] = wp.sign(p[axis])
        face = 2 * axis + wp.where(p[axis] > 0.0, 1, 0)
    elif kind == CYLINDER:
        shape = view.shapes[view.part_shape[env, part]]
        beside = wp.abs(1.0 - wp.sqrt(p[0] * p[0] + p[1] * p[1])) * shape.half[0]
        above = wp.abs(1.0 - wp.abs(p[2])) * shape.half[2]
        slope = wp.vec3(p[0], p[1], 0.0)
        if above < beside:
            slope = wp.vec3(0.0, 0.0, wp.sign(p[2]))
            face = wp.where(p[2] > 0.0, 2, 1)
    elif kind == CAPSULE:
        shape = view.shapes[view.part_shape[env, part]]
        own = wp.cw_mul(p, shape.half)
        along = wp.clamp(own[2], -shape.size[1], shape.size[1])
        slope = wp.cw_mul(wp.vec3(own[0], own[1], own[2] - along), shape.half)
    elif kind == PLANE:
        slope = wp.vec3(0.0, 0.0, 1.0)
    elif kind == MESH:
        shape = view.shapes[view.part_shape[env, part]]
        start = wp.cw_mul(wp.vec3(x[3], y[3], z[3]), shape.half) + shape.center
        heading = wp.cw_mul(wp.vec3(wp.dot(a, ray), wp.dot(b, ray), wp.dot(c, ray)), shape.half)
        query = wp.mesh_query_ray(shape.ray_mesh, start, heading, 1.001 * distance + 1.0e-4)
        slope = wp.cw_mul(query.normal, shape.half)
        face = query.face
        u = query.u
        v = query.v
    normal = wp.normalize(slope[0] * a + slope[1] * b + slope[2] * c)
    surface = Surface()
    surface.normal = wp.where(wp.dot(normal, ray) > 0.0, -normal, normal)
    surface.face = face
    surface.place = p
    surface.slope = slope
    surface.u = u
    surface.v = v
    return surface
