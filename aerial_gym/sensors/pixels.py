"""Pixel values of a ray hit: distance with noise, limits and normalisation, id, point, normal and face.

The function that writes a pixel is composed for the sensor's images; others cost nothing.

Frames: a sensor looks along its own x. Letters: E environments, B vehicles of all of them,
M mounts (sensors of all vehicles), N pixels, P parts.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from aerial_gym.config.images import MISS_FACE as _MISS_FACE
from aerial_gym.config.images import MISS_ID as _MISS_ID
from aerial_gym.math.draws import RandomArrays, episode_stream, substream
from aerial_gym.math.random import Purpose
from aerial_gym.sensors.flow import ray_flow
from aerial_gym.sensors.images import arrays_type
from aerial_gym.sensors.sensor_view import SensorView, is_blocked
from aerial_gym.sensors.shading import Light, hit_surface, pixel_color

MISS_ID = wp.constant(_MISS_ID)
MISS_FACE = wp.constant(_MISS_FACE)


@dataclass(frozen=True, kw_only=True)
class PixelOutputs:
    """Images that a sensor writes, and the pixel computations that they need."""

    images: tuple[str, ...]  # Names in `IMAGES`
    in_world: tuple[str, ...]  # Images in the world frame
    noise: bool  # Whether the distance has noise
    shadows: bool  # Whether lights throw shadows
    lamps: bool  # Whether the environment has lamps
    scan: bool  # Whether columns of a scanning lidar have poses of their own
    frames: bool = False  # Whether the ray pattern differs between images
    shared: bool = False  # Whether several vehicles see the scene of an environment


@wp.struct
class DistanceLimits:
    """Range limits and scale of a distance."""

    min_range: wp.float32  # [m]
    max_range: wp.float32  # [m]
    projected: wp.bool  # distances along the sensor's x axis instead of along the ray
    divisor: wp.float32  # of distances within the limits: max_range or 1
    near_pixel: wp.float32  # written for a hit closer than min_range, and for a dropped pixel
    far_pixel: wp.float32  # written for a miss
    baseline: wp.float32  # of the second camera of a stereo pair, along y [m]
    half_width: wp.float32  # tangent of half its horizontal field of view
    half_height: wp.float32  # and of half its vertical one
    focal_baseline: wp.float32  # disparity times depth [pixel m]


@wp.struct
class DistanceNoise:
    """Noise of a distance r: N(r - mean_offset, (a r² + b r + c)²), or the pixel is dropped."""

    std_a: wp.float32  # [1/m]
    std_b: wp.float32  # [-]
    std_c: wp.float32  # [m]
    mean_offset: wp.float32  # [m]
    dropout: wp.float32  # probability
    random: RandomArrays
    sensor: wp.int32  # number of the kind on its robot
    mounts: wp.int32  # sensors of the kind on a robot
    image: wp.array[wp.int32]  # (B,) how many images were taken since the reset


@wp.func
def ray_limit(limits: DistanceLimits, ray: wp.vec3) -> float:
    """Return the range limit along a ray [m]."""
    return wp.where(limits.projected, limits.max_range / ray[0], limits.max_range)


SURFACE_SKIN = wp.constant(1.0e-4)  # Relative distance of a point behind the second camera's hit, for rounding


@wp.func
def second_camera_sees(view: SensorView, limits: DistanceLimits, env: int, mount: int, point: wp.vec3) -> wp.bool:
    """Return whether a point in the sensor's frame is in the image of the second camera, with nothing in between."""
    start = wp.vec3(0.0, limits.baseline, 0.0)
    to = point - start
    if to[0] <= 0.0 or wp.abs(to[1]) > limits.half_width * to[0] or wp.abs(to[2]) > limits.half_height * to[0]:
        return False
    distance = wp.length(to)
    return not is_blocked(view, env, mount, start, to / distance, (1.0 - SURFACE_SKIN) * distance)


@cache
def make_write_pixel(outputs: PixelOutputs) -> wp.Function:
    """Return the function that writes a pixel of a sensor with these outputs."""
    images_type, written, in_world = arrays_type(outputs.images), outputs.images, outputs.in_world
    has_noise, shadows, lamps, shared = outputs.noise, outputs.shadows, outputs.lamps, outputs.shared
    segments, faces, stereo = "segmentation" in written, "face_ids" in written, "disparity" in written
    colors, flows = "color" in written, "optical_flow" in written
    points, points_in_world = "points" in written, "points" in in_world
    normals, normals_in_world = "normals" in written, "normals" in in_world

    # mount: the image; seat: the pose, a row of the view, which differs from the mount for a scanning lidar
    @wp.func
    def write_pixel(
        images: images_type, limits: DistanceLimits, noise: DistanceNoise, light: Light, view: SensorView, env: int,
        mount: int, seat: int, pixel: int, ray: wp.vec3, nearest: float, hit: int,
    ):  # fmt: skip
        along = wp.where(limits.projected, ray[0], 1.0)
        measured = nearest * along
        dropped = wp.bool(False)
        if wp.static(has_noise):
            body = env
            if wp.static(shared):
                body = mount // noise.mounts
            taken = substream(episode_stream(noise.random, body, wp.static(int(Purpose.IMAGE_NOISE))), noise.sensor)
            own = (mount - body * noise.mounts) * images.distance.shape[1] + pixel
            random = substream(substream(taken, noise.image[body]), own)
            dropped = wp.randf(random) < noise.dropout
            std = (noise.std_a * measured + noise.std_b) * measured + noise.std_c
            measured += std * wp.randn(random) - noise.mean_offset
        else:
            measured = wp.min(measured, limits.max_range)
        if wp.static(stereo):  # noqa: SIM102 - a condition of the composition, and one of the pixel
            if hit >= 0:
                dropped = dropped or not second_camera_sees(view, limits, env, seat, nearest * ray)
        value = measured / limits.divisor
        if hit < 0 or measured > limits.max_range:
            value = limits.far_pixel
        elif measured < limits.min_range:
            value = limits.near_pixel
        if dropped:
            value = limits.near_pixel
        images.distance[mount, pixel] = value
        if wp.static(segments):
            seen = wp.int32(MISS_ID)
            if hit >= 0:
                seen = images.semantic_id[env, hit]
            images.segmentation[mount, pixel] = seen
        if wp.static(flows):
            images.optical_flow[mount, pixel] = ray_flow(images.flow, env, mount, pixel, ray, nearest, hit)
        valid = hit >= 0 and not dropped and measured >= limits.min_range and measured <= limits.max_range
        if wp.static(stereo):
            images.disparity[mount, pixel] = wp.where(valid, limits.focal_baseline * along / (measured * ray[0]), 0.0)
        if wp.static(points):
            point = wp.where(valid, (measured / along) * ray, wp.vec3(0.0, 0.0, 0.0))
            if wp.static(points_in_world):
                point = images.origin[seat] + wp.quat_rotate(images.attitude[seat], point)
            images.points[mount, pixel] = point
        if wp.static(normals or faces or colors):
            normal = wp.vec3(0.0, 0.0, 0.0)
            face = wp.int32(MISS_FACE)
            color = light.sky
            if hit >= 0:
                surface = hit_surface(view, env, seat, hit, ray, nearest)
                if wp.static(colors):
                    place = images.origin[seat]
                    turn = images.attitude[seat]
                    color = pixel_color(
                        view, light, env, seat, hit, surface, nearest * ray, place, turn, wp.static(shadows),
                        wp.static(lamps),
                    )  # fmt: skip
                normal = surface.normal
                face = surface.face
            if wp.static(normals_in_world):
                normal = wp.quat_rotate(images.attitude[seat], normal)
            if wp.static(normals):
                images.normals[mount, pixel] = normal
            if wp.static(faces):
                images.face_ids[mount, pixel] = face
            if wp.static(colors):
                images.color[mount, pixel] = color

    return write_pixel
