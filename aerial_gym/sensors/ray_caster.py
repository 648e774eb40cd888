# pyright: reportArgumentType=false, reportAssignmentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false, reportOptionalMemberAccess=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""The ray caster: one kernel writes distances and segmentation of a sensor in every environment.

A sensor is a table of ray directions and a mount, so that any camera or lidar model runs through the same kernel. Mounts
and directions are buffers that may be written between calls, also after a CUDA graph was captured. Neighbouring threads
are neighbouring pixels of a row, in the order of memory.

Frames: body is x forward, y left, z up; a sensor looks along its own x. World is the environment's own, z up.
Letters: E environments, A instances, S sensors of one kind, H x W = N pixels (row 0 on top).
"""

from functools import cache

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.geometry import MESH
from aerial_gym.assets.scene import Scene
from aerial_gym.assets.views import check_tensor, vector_view
from aerial_gym.config.sensor import CameraCfg
from aerial_gym.errors import ShapeError
from aerial_gym.interop import launch_side_by_side, on_torch_stream, split
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.sensors.rays import pinhole_rays
from aerial_gym.sensors.tiles import make_tiles
from aerial_gym.sensors.view import View, ballot, entry_of, least_lane, look, lowest_bit, trace

MISS_ID = wp.constant(-2)
"""Segmentation of a pixel that sees nothing within its range. Source: parity with Aerial Gym (3.4)."""

GPU_TILE, CPU_TILE = (4, 8), (8, 16)
"""Rows and columns of pixels whose rays are traced together; a warp has 32 threads."""

BLOCK_DIM = 128


@wp.struct
class Limits:
    """What becomes of a distance."""

    min_range: wp.float32  # [m]
    max_range: wp.float32  # [m]
    projected: wp.bool  # distances along the sensor's x axis instead of along the ray
    divisor: wp.float32  # of distances within the limits: max_range or 1
    near_pixel: wp.float32  # written for a hit closer than min_range
    far_pixel: wp.float32  # written for a miss


@wp.struct
class Rays:
    """The rays of a sensor in tiles of L."""

    direction: wp.array[wp.vec3]  # (T * L,) sensor frame, unit
    pixel: wp.array[wp.int32]  # (T * L,) which pixel of the image, or -1
    middle: wp.array[wp.vec3]  # (T,) of the directions of a tile
    spread: wp.array[wp.vec3]  # (T,) half of what they differ by


@wp.struct
class Images:
    """Where a kernel writes."""

    distance: wp.array2d[float]  # (M, N) [m] or divided
    segmentation: wp.array2d[wp.int32]  # (M, N)
    semantic_id: wp.array2d[wp.int32]  # (E, P) of the scene
    segments: wp.bool  # whether segmentation is written


@wp.func
def limit_of(limits: Limits, ray: wp.vec3) -> float:
    """Return the distance along a ray beyond which nothing is seen [m]."""
    return wp.where(limits.projected, limits.max_range / ray[0], limits.max_range)


@wp.func
def write_pixel(
    images: Images, limits: Limits, env: int, mount: int, pixel: int, ray: wp.vec3, nearest: float, hit: int
):
    """Write what a ray found: the distance to the first surface and its id, or ``far_pixel`` and ``MISS_ID``."""
    measured = wp.min(wp.where(limits.projected, nearest * ray[0], nearest), limits.max_range)
    value = wp.where(measured < limits.min_range, limits.near_pixel, measured / limits.divisor)
    images.distance[mount, pixel] = wp.where(hit >= 0, value, limits.far_pixel)
    if images.segments:
        seen = wp.int32(MISS_ID)
        if hit >= 0:
            seen = images.semantic_id[env, hit]
        images.segmentation[mount, pixel] = seen


@wp.kernel(enable_backward=False)
def _cast_by_warp(view: View, rays: Rays, limits: Limits, sensors: int, images: Images):
    """Trace one ray per thread; the 32 threads of a warp hold one tile and look for its candidates together.

    Analytic shapes come before meshes, and near meshes before far ones, so that a tree is searched only up to what was found.
    """
    thread = wp.tid()
    lane = thread & 31
    num_tiles = rays.middle.shape[0]
    mount = (thread >> 5) // num_tiles
    tile = (thread >> 5) - mount * num_tiles
    env = mount // sensors
    middle = rays.middle[tile]
    spread = rays.spread[tile]
    ray = rays.direction[tile * 32 + lane]
    pixel = rays.pixel[tile * 32 + lane]
    nearest = limit_of(limits, ray)
    hit = wp.int32(-1)
    count = view.kind.shape[1]
    first = wp.int32(0)
    while first < count:
        a = first + lane
        entry = float(wp.inf)
        mesh = wp.bool(False)
        if a < count:
            entry = entry_of(view, mount, a, middle, spread)
            mesh = view.kind[mount, a] == MESH
        analytic = ballot(entry < wp.inf and not mesh)
        meshes = ballot(entry < wp.inf and mesh)
        while analytic != wp.uint32(0):
            i = first + lowest_bit(analytic)
            analytic = analytic & (analytic - wp.uint32(1))
            distance = trace(view, env, mount, i, ray, nearest)
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
            distance = trace(view, env, mount, i, ray, nearest)
            if distance < nearest:
                nearest = distance
                hit = i
        first += 32
    if pixel >= 0:
        write_pixel(images, limits, env, mount, pixel, ray, nearest, hit)


@cache
def _make_tile_kernel(num_instances: int) -> wp.Kernel:
    """Return the kernel in which one thread traces all rays of a tile: for processors without warps."""
    num_words = max(1, -(-num_instances // 32))
    words_type = wp.types.vector(length=num_words, dtype=wp.uint32)

    @wp.func
    def find_candidates(view: View, mount: int, middle: wp.vec3, spread: wp.vec3, meshes: wp.bool) -> words_type:
        words = words_type()
        for a in range(view.kind.shape[1]):
            if (view.kind[mount, a] == MESH) == meshes and entry_of(view, mount, a, middle, spread) < wp.inf:
                words[a >> 5] = words[a >> 5] | (wp.uint32(1) << wp.uint32(a & 31))
        return words

    @wp.func
    def nearest_of(
        view: View, env: int, mount: int, words: words_type, ray: wp.vec3, limit: float, before: int
    ) -> tuple[float, int]:
        nearest = limit
        hit = before
        for k in range(num_words):
            bits = words[k]
            while bits != wp.uint32(0):
                i = 32 * k + lowest_bit(bits)
                bits = bits & (bits - wp.uint32(1))
                distance = trace(view, env, mount, i, ray, nearest)
                if distance < nearest:
                    nearest = distance
                    hit = i
        return nearest, hit

    @wp.kernel(module="unique", enable_backward=False)
    def cast_by_tile(view: View, rays: Rays, limits: Limits, sensors: int, images: Images, per_tile: int, first: int):
        """Trace all rays of one tile; analytic shapes come before meshes."""
        task = wp.tid() + first
        num_tiles = rays.middle.shape[0]
        mount = task // num_tiles
        tile = task - mount * num_tiles
        env = mount // sensors
        analytic = find_candidates(view, mount, rays.middle[tile], rays.spread[tile], False)
        meshes = find_candidates(view, mount, rays.middle[tile], rays.spread[tile], True)
        for i in range(per_tile):
            pixel = rays.pixel[tile * per_tile + i]
            if pixel >= 0:
                ray = rays.direction[tile * per_tile + i]
                nearest, hit = nearest_of(view, env, mount, analytic, ray, limit_of(limits, ray), -1)
                nearest, hit = nearest_of(view, env, mount, meshes, ray, nearest, hit)
                write_pixel(images, limits, env, mount, pixel, ray, nearest, hit)

    return cast_by_tile


class RayCaster:
    """A camera in every environment, with all views made at construction."""

    def __init__(
        self,
        cfg: CameraCfg,
        scene: Scene,
        *,
        position: Tensor,
        attitude: Tensor,
        distance_out: Tensor,
        segmentation_out: Tensor | None = None,
    ) -> None:
        """Take views of the tensors, which must stay where they are, and load the kernel.

        Args:
            cfg: The camera.
            scene: What it sees.
            position: Body origin [m], world, (E, 3); may be strided, but for the last axis.
            attitude: Body to world, xyzw, unit, (E, 4); likewise.
            distance_out: Receives distances [m], or shares of max_range if the camera normalises, float32, (E, S, H, W).
            segmentation_out: Receives semantic ids, -2 for a miss, int32, (E, S, H, W); given if and only if the camera
                segments.

        Raises:
            ShapeError: If a tensor does not fit camera and scene.
        """
        envs, device = scene.num_envs, scene.device
        self.num_sensors = distance_out.shape[1] if distance_out.dim() == 4 else 1
        image = (envs, self.num_sensors, cfg.height, cfg.width)
        _check_image("distance_out", distance_out, image, device=device, dtype=torch.float32)
        if (segmentation_out is not None) != cfg.segmentation:
            raise ShapeError(f"segmentation_out must be given exactly if the camera segments: it is {cfg.segmentation}")
        if segmentation_out is not None:
            _check_image("segmentation_out", segmentation_out, image, device=device, dtype=torch.int32)
        self.cfg, self._out = cfg, distance_out
        self.direction = pinhole_rays(cfg, device=device)
        mounts, pixels = image[:2], cfg.height * cfg.width
        self._nominal_position = torch.tensor(cfg.position, device=device)
        self._nominal_attitude = quat_from_euler(torch.tensor(cfg.euler, device=device))
        self.mount_position = self._nominal_position.expand(*mounts, 3).clone()
        self.mount_attitude = self._nominal_attitude.expand(*mounts, 4).clone()
        shared = [
            scene.arrays,
            vector_view("position", position, (envs, 3), device=device),
            vector_view("attitude", attitude, (envs, 4), device=device),
            vector_view("mount_position", self.mount_position, (*mounts, 3), device=device),
            vector_view("mount_attitude", self.mount_attitude, (*mounts, 4), device=device),
        ]
        self._view = _make_view(scene, envs * self.num_sensors)
        self._look = wp.launch(
            look,
            dim=(envs * self.num_sensors, scene.num_parts),
            inputs=[*shared, self._reach()],
            outputs=[self._view.rows, self._view.kind],
            device=wp.device_from_torch(device),
            record_cmd=True,
        )
        self._images = _make_images(scene, distance_out.view(-1, pixels), segmentation_out, pixels)
        self._launches = self._record(device)

    def _reach(self) -> float:
        """Return the longest distance along any ray at which something is seen [m]."""
        cosine = float(self.direction[..., 0].min()) if self.cfg.kind == "depth" else 1.0
        return self.cfg.max_range / cosine

    def _record(self, device: torch.device) -> list[wp.Launch]:
        """Record the launches that trace the rays."""
        height, width = GPU_TILE if device.type == "cuda" else CPU_TILE
        tiles = make_tiles(self.direction, height=height, width=width)
        self._rays = Rays()
        self._rays.direction = wp.from_torch(tiles.direction, dtype=wp.vec3)
        self._rays.pixel = wp.from_torch(tiles.pixel)
        self._rays.middle = wp.from_torch(tiles.middle, dtype=wp.vec3)
        self._rays.spread = wp.from_torch(tiles.spread, dtype=wp.vec3)
        inputs = [self._view, self._rays, _limits(self.cfg), self.num_sensors, self._images]
        mounts, num_tiles = self._view.kind.shape[0], tiles.num_tiles

        def record(kernel: wp.Kernel, dim: int, *more: int) -> wp.Launch:
            return wp.launch(
                kernel,
                dim=dim,
                inputs=[*inputs, *more],
                device=wp.device_from_torch(device),
                block_dim=BLOCK_DIM,
                record_cmd=True,
            )

        if device.type == "cuda":
            return [record(_cast_by_warp, mounts * num_tiles * 32)]
        kernel, per_tile = _make_tile_kernel(self._view.kind.shape[1]), height * width
        chunks = split(mounts * num_tiles, torch.get_num_threads())
        return [record(kernel, count, per_tile, first) for first, count in chunks]

    def cast(self) -> None:
        """Write every pixel from the present poses; launched on torch's current stream, not waited for."""
        with on_torch_stream(self._out):
            if self._look is not None:  # a scene without instances has nothing to look at
                self._look.launch()
            launch_side_by_side(self._launches)

    def reset(self, mask: Tensor) -> None:
        """Put the mounts of masked environments, bool (E,), back to where the configuration has them."""
        rows = mask[:, None, None]
        self.mount_position.copy_(torch.where(rows, self._nominal_position, self.mount_position))
        self.mount_attitude.copy_(torch.where(rows, self._nominal_attitude, self.mount_attitude))


def _limits(cfg: CameraCfg) -> Limits:
    limits = Limits()
    limits.min_range, limits.max_range = cfg.min_range, cfg.max_range
    limits.projected = cfg.kind == "depth"
    limits.divisor = cfg.max_range if cfg.normalize else 1.0
    limits.near_pixel, limits.far_pixel = cfg.near_pixel, cfg.far_pixel
    return limits


def _make_view(scene: Scene, mounts: int) -> View:
    device, count = wp.device_from_torch(scene.device), scene.num_parts
    view = View()
    view.rows = wp.zeros((mounts, 3 * count), dtype=wp.vec4, device=device)
    view.kind = wp.zeros((mounts, count), dtype=wp.int32, device=device)
    view.shapes, view.part_shape = scene.arrays.shapes, scene.arrays.part_shape
    return view


def _make_images(scene: Scene, distance: Tensor, segmentation: Tensor | None, pixels: int) -> Images:
    images = Images()
    images.distance, images.semantic_id = wp.from_torch(distance), scene.arrays.semantic_id
    images.segments = segmentation is not None
    if segmentation is None:
        images.segmentation = wp.empty((0, 0), dtype=wp.int32, device=wp.device_from_torch(scene.device))
    else:
        images.segmentation = wp.from_torch(segmentation.view(-1, pixels))
    return images


def _check_image(name: str, image: Tensor, shape: tuple[int, ...], *, device: torch.device, dtype: torch.dtype) -> None:
    check_tensor(name, image, shape, device=device, dtype=dtype)
    if not image.is_contiguous():
        raise ShapeError(f"{name} has stride {image.stride()}: images must be contiguous")
