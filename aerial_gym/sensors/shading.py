"""Hit points of rays, surface colour and texture, and light from sky, sun and lamps.

Only kernels that write normals, faces or colours contain any of this.
Frames: a sensor looks along its own x. Letters: E environments, M mounts (sensors of all environments), P parts, L lamps.
"""

import warp as wp

from aerial_gym.assets.appearance import NO_ENTRY, AppearanceArrays, Texture
from aerial_gym.assets.scene_arrays import BOX, CAPSULE, CYLINDER, MESH, PLANE
from aerial_gym.sensors.sensor_view import SensorView, is_blocked


@wp.struct
class Surface:
    """Hit point of a ray on a part."""

    normal: wp.vec3  # unit, sensor frame, towards the sensor
    face: wp.int32  # triangle of a mesh; box: 2 axis + (1 on the upper side); cylinder: 0 side, 1 bottom, 2 top; else 0
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


@wp.struct
class Light:
    """Lights, colours and textures of a scene."""

    sun: wp.vec3  # unit direction to the sun, world; 0 without a sun
    ambient: wp.float32  # share of the light that comes from the sky
    sky: wp.vec3  # colour of a miss
    lamp_position: wp.array[wp.vec3]  # (L,) world [m]
    lamp_power: wp.array[wp.vec3]  # (L,) brightness of a white surface that faces it, times squared distance [m²]
    looks: AppearanceArrays


SHADOW_LIFT = wp.constant(1.0e-3)  # Height of the start of a ray to a light, per distance and at least in metres
FAR_AWAY = wp.constant(1.0e4)  # Distance [m] before which something on the way to the sun casts a shadow
NEAREST = wp.constant(1.0e-6)  # Least squared distance of a lamp to a surface [m²], 1 mm: the light stays finite
DEPTH_OF_FIELDS = wp.constant(0.01)  # Depth of a checkerboard look-up per field: a face lies within one layer


@wp.func
def shadow_ray_start(surface: Surface, point: wp.vec3) -> wp.vec3:
    """Return the start of a shadow ray, lifted off the surface against self-intersection, sensor frame [m]."""
    return point + SHADOW_LIFT * wp.max(wp.length(point), 1.0) * surface.normal


@wp.func
def sunlight(
    view: SensorView, env: int, mount: int, surface: Surface, point: wp.vec3, sun: wp.vec3, shadows: wp.bool
) -> float:
    """Return the share of the sun's light on a surface, ``max(n . s, 0)``, or 0 in shadow; all in the sensor's frame.

    Source: Lambert (1760), Photometria: matt surfaces.
    """
    share = wp.max(wp.dot(surface.normal, sun), 0.0)
    if shadows and share > 0.0:
        start = shadow_ray_start(surface, point)
        if is_blocked(view, env, mount, start, sun, FAR_AWAY):
            return 0.0
    return share


@wp.func
def lamplight(
    view: SensorView, env: int, mount: int, surface: Surface, point: wp.vec3, lamp: wp.vec3, shadows: wp.bool
) -> float:
    """Return ``max(n . l, 0) / r²`` of a lamp at distance r in direction l [1/m²], or 0 in shadow.

    Point and lamp [m] are in the sensor's frame.

    Source: Lambert (1760), Photometria: matt surfaces and the square of the distance.
    """
    to = lamp - point
    square = wp.max(wp.dot(to, to), NEAREST)
    share = wp.max(wp.dot(surface.normal, to) / wp.sqrt(square), 0.0) / square
    if shadows and share > 0.0:
        start = shadow_ray_start(surface, point)
        way = lamp - start
        distance = wp.length(way)
        if is_blocked(view, env, mount, start, wp.normalize(way), distance):
            return 0.0
    return share


@wp.func
def texel(looks: AppearanceArrays, texture: Texture, column: int, row: int) -> wp.vec3:
    """Return the colour of a texture pixel; the image repeats in both directions."""
    x = column - texture.width * int(wp.floor(float(column) / float(texture.width)))
    y = row - texture.height * int(wp.floor(float(row) / float(texture.height)))
    x = wp.clamp(x, 0, texture.width - 1)
    y = wp.clamp(y, 0, texture.height - 1)
    channels = looks.texels[texture.first + y * texture.width + x]
    return wp.vec3(float(channels[0]), float(channels[1]), float(channels[2])) / 255.0


@wp.func
def texture_color(looks: AppearanceArrays, texture: Texture, uv: wp.vec2) -> wp.vec3:
    """Return the colour of an image at (u, v), linear between the middles of its pixels; the image repeats."""
    u = uv[0] - wp.floor(uv[0])
    v = uv[1] - wp.floor(uv[1])
    x = u * float(texture.width) - 0.5
    y = (1.0 - v) * float(texture.height) - 0.5
    column = wp.floor(x)
    row = wp.floor(y)
    right = x - column
    down = y - row
    i = int(column)
    j = int(row)
    above = (1.0 - right) * texel(looks, texture, i, j) + right * texel(looks, texture, i + 1, j)
    below = (1.0 - right) * texel(looks, texture, i, j + 1) + right * texel(looks, texture, i + 1, j + 1)
    return (1.0 - down) * above + down * below


@wp.func
def surface_color(view: SensorView, looks: AppearanceArrays, env: int, part: int, surface: Surface) -> wp.vec3:
    """Return the colour of a surface in white light."""
    row = view.part_shape[env, part]
    look = looks.shape[row]
    color = look.color
    if look.first_face != NO_ENTRY and surface.face >= 0:
        face = look.first_face + surface.face
        w = 1.0 - surface.u - surface.v
        a = 3 * face
        color = (
            surface.u * looks.corner_color[a] + surface.v * looks.corner_color[a + 1] + w * looks.corner_color[a + 2]
        )
        image = looks.face_texture[face]
        if image != NO_ENTRY:
            uv = surface.u * looks.corner_uv[a] + surface.v * looks.corner_uv[a + 1] + w * looks.corner_uv[a + 2]
            color = wp.cw_mul(color, texture_color(looks, looks.textures[image], uv))
    if look.checker_size > 0.0:
        shape = view.shapes[row]
        outward = wp.normalize(wp.cw_div(surface.slope, shape.half))
        own = wp.cw_mul(surface.place, shape.half) + shape.center - DEPTH_OF_FIELDS * look.checker_size * outward
        fields = wp.floor(own[0] / look.checker_size) + wp.floor(own[1] / look.checker_size)
        fields += wp.floor(own[2] / look.checker_size)
        if int(fields) & 1:
            color = look.checker_color
    return color


@wp.func
def pixel_color(
    view: SensorView, light: Light, env: int, mount: int, part: int, surface: Surface, point: wp.vec3, place: wp.vec3,
    turn: wp.quat, shadows: wp.bool, lamps: wp.bool,
) -> wp.vec3:  # fmt: skip
    """Return the colour of a pixel, no channel above 1.

    The point is in the sensor's frame [m]; ``place`` and ``turn`` are where the sensor is, world.
    """
    sun = wp.quat_rotate_inv(turn, light.sun)
    lit = sunlight(view, env, mount, surface, point, sun, shadows)
    bright = light.ambient + (1.0 - light.ambient) * lit
    power = wp.vec3(bright, bright, bright)
    if lamps:
        for k in range(light.lamp_position.shape[0]):
            lamp = wp.quat_rotate_inv(turn, light.lamp_position[k] - place)
            power += lamplight(view, env, mount, surface, point, lamp, shadows) * light.lamp_power[k]
    color = wp.cw_mul(power, surface_color(view, light.looks, env, part, surface))
    return wp.min(color, wp.vec3(1.0, 1.0, 1.0))
