"""The kernels that trace the rays of a sensor in every environment, composed for the images that it has.

Letters: B vehicles of all environments, S sensors of one kind, M = B * S mounts, K frames, T tiles, L rays of a tile, P parts.
"""

from functools import cache

import warp as wp

from aerial_gym.assets.scene_arrays import MESH
from aerial_gym.sensors.images import arrays_type
from aerial_gym.sensors.pixels import DistanceLimits, DistanceNoise, PixelOutputs, make_write_pixel, ray_limit
from aerial_gym.sensors.sensor_view import SensorView, ballot, least_lane, lowest_bit, part_entry, ray_distance
from aerial_gym.sensors.shading import Light


@wp.struct
class Rays:
    """The rays of a sensor in tiles of L, in K frames."""

    direction: wp.array[wp.vec3]  # (K * T * L,) sensor frame, unit
    pixel: wp.array[wp.int32]  # (T * L,) which pixel of the image, or -1
    middle: wp.array[wp.vec3]  # (K * T,) of the directions of a tile
    spread: wp.array[wp.vec3]  # (K * T,) half of their spread
    num_tiles: wp.int32  # T
    frame: wp.array[wp.int32]  # (B,) which of K frames an image has; empty where K is 1
    group: wp.array[wp.int32]  # (T,) group of columns of a turning lidar
    groups: wp.int32  # number of groups G; the view has a row for each of every mount


@cache
def make_warp_kernel(outputs: PixelOutputs) -> wp.Kernel:
    """Return the kernel with one ray per thread, for GPUs: the 32 threads of a warp hold one tile."""
    write_pixel, images_type = make_write_pixel(outputs), arrays_type(outputs.images)

    @wp.kernel(module="unique", enable_backward=False)
    def cast_by_warp(
        view: SensorView, rays: Rays, limits: DistanceLimits, noise: DistanceNoise, light: Light, sensors: int,
        due: wp.array[wp.bool], images: images_type,
    ):  # fmt: skip
        """Trace one ray; the threads of a warp search the candidates of their tile together.

        Analytic shapes come before meshes, and near meshes before far ones, so that a tree is searched only up to what was
        found.
        """
        thread = wp.tid()
        lane = thread & 31
        num_tiles = rays.num_tiles
        mount = (thread >> 5) // num_tiles
        tile = (thread >> 5) - mount * num_tiles
        body = mount // sensors
        if not due[body]:
            return
        env = body
        if wp.static(outputs.shared):
            env = body // view.vehicles
        seat = mount
        if wp.static(outputs.scan):
            seat = mount * rays.groups + rays.group[tile]
        seen = tile
        if wp.static(outputs.frames):
            seen = rays.frame[body] * num_tiles + tile
        middle = rays.middle[seen]
        spread = rays.spread[seen]
        ray = rays.direction[seen * 32 + lane]
        pixel = rays.pixel[tile * 32 + lane]
        nearest = ray_limit(limits, ray)
        hit = wp.int32(-1)
        count = view.kind.shape[1]
        first = wp.int32(0)
        while first < count:
            a = first + lane
            entry = float(wp.inf)
            mesh = wp.bool(False)
            if a < count:
                entry = part_entry(view, seat, a, middle, spread)
                mesh = view.kind[seat, a] == MESH
            analytic = ballot(entry < wp.inf and not mesh)
            meshes = ballot(entry < wp.inf and mesh)
            while analytic != wp.uint32(0):
                i = first + lowest_bit(analytic)
                analytic = analytic & (analytic - wp.uint32(1))
                distance = ray_distance(view, env, seat, i, ray, nearest)
                if distance < nearest:
                    nearest = distance
                    hit = i
            if not mesh:
                entry = wp.inf
            while meshes != wp.uint32(0):
                closest = least_lane(entry)
                i = first + closest
                meshes = meshes & ~(wp.uint32(1) << wp.uint32(closest))
                if lane == closest:
                    entry = wp.inf
                distance = ray_distance(view, env, seat, i, ray, nearest)
                if distance < nearest:
                    nearest = distance
                    hit = i
            first += 32
        if pixel >= 0:
            write_pixel(images, limits, noise, light, view, env, mount, seat, pixel, ray, nearest, hit)

    return cast_by_warp


@cache
def make_tile_kernel(outputs: PixelOutputs, num_parts: int) -> wp.Kernel:
    """Return the kernel in which one thread traces all rays of a tile: for processors without warps."""
    write_pixel, images_type = make_write_pixel(outputs), arrays_type(outputs.images)
    num_words = max(1, -(-num_parts // 32))
    words_type = wp.types.vector(length=num_words, dtype=wp.uint32)

    @wp.func
    def find_candidates(view: SensorView, mount: int, middle: wp.vec3, spread: wp.vec3, meshes: wp.bool) -> words_type:
        words = words_type()
        for a in range(view.kind.shape[1]):
            if (view.kind[mount, a] == MESH) == meshes and part_entry(view, mount, a, middle, spread) < wp.inf:
                words[a >> 5] = words[a >> 5] | (wp.uint32(1) << wp.uint32(a & 31))
        return words

    @wp.func
    def nearest_part(
        view: SensorView, env: int, mount: int, words: words_type, ray: wp.vec3, limit: float, before: int
    ) -> tuple[float, int]:
        nearest = limit
        hit = before
        for k in range(num_words):
            bits = words[k]
            while bits != wp.uint32(0):
                i = 32 * k + lowest_bit(bits)
                bits = bits & (bits - wp.uint32(1))
                distance = ray_distance(view, env, mount, i, ray, nearest)
                if distance < nearest:
                    nearest = distance
                    hit = i
        return nearest, hit

    @wp.kernel(module="unique", enable_backward=False)
    def cast_by_tile(
        view: SensorView, rays: Rays, limits: DistanceLimits, noise: DistanceNoise, light: Light, sensors: int,
        due: wp.array[wp.bool], images: images_type, per_tile: int, first: int,
    ):  # fmt: skip
        """Trace all rays of one tile; analytic shapes come before meshes."""
        task = wp.tid() + first
        num_tiles = rays.num_tiles
        mount = task // num_tiles
        tile = task - mount * num_tiles
        body = mount // sensors
        if not due[body]:
            return
        env = body
        if wp.static(outputs.shared):
            env = body // view.vehicles
        seat = mount
        if wp.static(outputs.scan):
            seat = mount * rays.groups + rays.group[tile]
        seen = tile
        if wp.static(outputs.frames):
            seen = rays.frame[body] * num_tiles + tile
        analytic = find_candidates(view, seat, rays.middle[seen], rays.spread[seen], False)
        meshes = find_candidates(view, seat, rays.middle[seen], rays.spread[seen], True)
        for i in range(per_tile):
            pixel = rays.pixel[tile * per_tile + i]
            if pixel >= 0:
                ray = rays.direction[seen * per_tile + i]
                nearest, hit = nearest_part(view, env, seat, analytic, ray, ray_limit(limits, ray), -1)
                nearest, hit = nearest_part(view, env, seat, meshes, ray, nearest, hit)
                write_pixel(images, limits, noise, light, view, env, mount, seat, pixel, ray, nearest, hit)

    return cast_by_tile
