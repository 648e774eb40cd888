"""The ray caster: one kernel writes every image of a sensor on every vehicle.

A sensor is a table of ray directions and a mount, so that any camera or lidar model runs through the same kernel. Mounts
are buffers that may be written between calls, also after a CUDA graph was captured.

Frames: body is x forward, y left, z up; a sensor looks along its own x. World is the environment's own, z up.
Letters: E environments, B vehicles of all of them (vehicle b is in environment ``b // (B / E)``), S sensors of one kind,
M = B * S mounts, H x W = N pixels (row 0 on top), P parts.
"""

from dataclasses import fields
from math import hypot, radians, tan

import numpy as np
import torch
import warp as wp
from torch import Tensor

from aerial_gym import interop
from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import vector_view
from aerial_gym.config.sensor import RangeSensorCfg, RosetteCfg, ScannedCfg, StereoCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.draws import random_arrays
from aerial_gym.math.random import Randomness
from aerial_gym.sensors.flow import Flow, make_flow_inputs, record_relative_twist
from aerial_gym.sensors.images import SensorImages, make_arrays, sensor_images
from aerial_gym.sensors.mounts import Carrier, OwnLinks, Pose
from aerial_gym.sensors.pixels import MISS_ID, DistanceLimits, DistanceNoise, PixelOutputs
from aerial_gym.sensors.ray_kernels import Rays, make_tile_kernel, make_warp_kernel
from aerial_gym.sensors.rays import make_tiles, ray_table, rosette_rays, stack_tiles
from aerial_gym.sensors.scan import ColumnScan
from aerial_gym.sensors.sensor_poses import SensorPoses, SensorsOnCarrier, write_sensor_poses
from aerial_gym.sensors.sensor_view import SensorView, write_parts_in_sensor_frames
from aerial_gym.sensors.shading import Light

__all__ = ["MISS_ID", "RayCaster", "SensorImages"]

GPU_TILE, CPU_TILE = (4, 8), (8, 16)  # Rows and columns of pixels whose rays are traced together; a warp has 32 threads
BLOCK_DIM = 64  # Threads of a block; 128 is 1 % and 256 is 7 to 24 % slower (docs/results/rendering.md)


@interop.with_usual_settings
class RayCaster:
    """The sensors of one kind on every vehicle, with all views made at construction."""

    def __init__(
        self, cfg: RangeSensorCfg, scene: Scene, images: SensorImages, carrier: Carrier, *,
        random: Randomness | None = None, number: int = 0, pose: Pose | None = None, own: OwnLinks | None = None,
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are, and load the kernel.

        Args:
            carrier: With velocities for optical flow, a lidar with a scan time and a rosette.
            number: Of the kind on its robot: two kinds are drawn apart.
            pose: Of its mount in the body frame, instead of its nominal placement. What is drawn deviates from the mount as
                it deviates from the nominal placement there: ``T_mount T_nominal^-1 T_drawn``.
            own: Links of the vehicles that carry the sensors, among those that the scene shows.
        """
        count, device = carrier.position.shape[0], scene.device
        images.check(cfg, count, device)
        self.cfg, self.images, self.num_sensors = cfg, images, cfg.count
        self._device, self._number = device, number
        self._random = random or Randomness(count, device=device)
        self.direction = ray_table(cfg, device=device)
        self.places = SensorPoses(cfg, self._random, number=number, pose=pose)
        self.due = torch.ones(count, dtype=torch.bool, device=device)
        """Vehicles whose images the next ``cast`` takes, bool, (B,)."""
        self._image_number = torch.zeros(count, dtype=torch.int32, device=device)
        self._num_frames = cfg.frames if isinstance(cfg, RosetteCfg) else 1
        self._frame = torch.full((count,), self._num_frames - 1, dtype=torch.int32, device=device)
        """Index of the ray pattern of the last image, int32, (B,)."""
        own = own or OwnLinks()
        sensors = interop.make_struct(
            SensorsOnCarrier, position=vector_view("position", carrier.position, (count, 3), device=device),
            attitude=vector_view("attitude", carrier.attitude, (count, 4), device=device),
            mount_position=self.places.position, mount_attitude=self.places.attitude, link=carrier.number,
            vehicles=count // scene.num_envs, first_link=own.first, num_links=own.count, hides_own=not own.seen,
            **_twist_views(cfg, carrier, count, device),
        )  # fmt: skip
        self._scan: ColumnScan | None = None
        if isinstance(cfg, ScannedCfg) and cfg.column_duration_s is not None:
            self._scan = ColumnScan(cfg, scene, sensors)
            sensors = self._scan.seats
        self._groups = 1 if self._scan is None else self._scan.groups
        self._view = _make_view(scene, count * cfg.count * self._groups, vehicles=sensors.vehicles)
        self._prepare = self._record_preparations(scene, sensors)
        self._flow = Flow()
        if images.optical_flow is not None:
            self._flow = make_flow_inputs(cfg, scene, count * cfg.count)
            self._prepare.append(record_relative_twist(self._flow, scene, sensors))
        self._launches = self._record_rays(scene)

    def _record_preparations(self, scene: Scene, sensors: SensorsOnCarrier) -> list[interop.ReusableLaunch]:
        """Record the launches before the rays: sensor poses, and parts in the sensors' frames."""
        mounts = self._view.kind.shape[0]  # seats of a turning lidar
        device = wp.device_from_torch(self._device)
        self._origin = wp.zeros(mounts, dtype=wp.vec3, device=device)
        self._attitude = wp.zeros(mounts, dtype=wp.quat, device=device)
        launches: list = [] if self._scan is None else [self._scan.record_placement()]
        if "world" in (self.cfg.points, self.cfg.normals) or self.cfg.light is not None:
            where = [self._origin, self._attitude]
            launches.append(
                interop.ReusableLaunch(write_sensor_poses, dim=mounts, inputs=[sensors], outputs=where, device=device)
            )
        if scene.num_parts and self._scan is not None:
            launches.append(self._scan.record_view(self._view, self._largest_range()))
        elif scene.num_parts:
            out, dim = [self._view.rows, self._view.kind], (mounts, scene.num_parts)
            inputs = [scene.arrays, sensors, self._largest_range()]
            launches.append(
                interop.ReusableLaunch(write_parts_in_sensor_frames, dim=dim, inputs=inputs, outputs=out, device=device)
            )
        return launches

    def _largest_range(self) -> float:
        """Return the largest range limit of all rays [m]."""
        cosine = float(self.direction[..., 0].min()) if self.cfg.kind == "depth" else 1.0
        return self.cfg.max_range / cosine

    def _record_rays(self, scene: Scene) -> list[interop.ReusableLaunch]:
        """Record the launches that trace the rays."""
        cfg, on_gpu = self.cfg, self._device.type == "cuda"
        height, width = GPU_TILE if on_gpu else CPU_TILE
        rays = Rays()
        rays.groups = self._groups
        if isinstance(cfg, RosetteCfg):
            height, width = 1, height * width  # neighbours in time look the same way
        directions = rosette_rays(cfg, device=self._device) if isinstance(cfg, RosetteCfg) else self.direction[None]
        if self._scan is None:
            parts = [make_tiles(direction, height=height, width=width) for direction in directions]
        else:
            tilings = [self._scan.make_tiles(direction, height=height, width=width) for direction in directions]
            parts = [tiles for tiles, _ in tilings]
            rays.group = wp.from_torch(tilings[0][1])
        tiles, rays.num_tiles, rays.frame = stack_tiles(parts), parts[0].num_tiles, wp.from_torch(self._frame)
        rays.direction, rays.pixel = wp.from_torch(tiles.direction, dtype=wp.vec3), wp.from_torch(tiles.pixel)
        rays.middle = wp.from_torch(tiles.middle, dtype=wp.vec3)
        rays.spread = wp.from_torch(tiles.spread, dtype=wp.vec3)
        outputs = PixelOutputs(
            images=tuple(self.images),
            in_world=tuple(name for name, image in sensor_images(cfg).items() if image.resolve_frame(cfg) == "world"),
            noise=cfg.active_noise is not None,
            shadows=cfg.light is not None and cfg.light.shadows,
            lamps=cfg.light is not None and bool(scene.lamps),
            scan=self._scan is not None,
            frames=self._num_frames > 1,
            shared=self._view.vehicles > 1,
        )
        images, due, light = self._make_images(scene), wp.from_torch(self.due), _light_arrays(cfg, scene)
        inputs = [self._view, rays, _distance_limits(cfg), self._make_noise(), light, self.num_sensors, due, images]
        mounts = self._view.kind.shape[0] // self._groups

        def record(kernel: wp.Kernel, dim: int, *more: int) -> interop.ReusableLaunch:
            device = wp.device_from_torch(self._device)
            given = [*inputs, *more]
            return interop.ReusableLaunch(kernel, dim=dim, inputs=given, device=device, block_dim=BLOCK_DIM)

        if on_gpu:
            return [record(make_warp_kernel(outputs), mounts * rays.num_tiles * 32)]
        kernel, per_tile = make_tile_kernel(outputs, self._view.kind.shape[1]), height * width
        chunks = interop.split(mounts * rays.num_tiles, torch.get_num_threads())
        return [record(kernel, count, per_tile, first) for first, count in chunks]

    def _make_images(self, scene: Scene) -> object:
        arrays = make_arrays(self.images)
        arrays.semantic_id, arrays.flow = scene.arrays.semantic_id, self._flow
        arrays.origin, arrays.attitude = self._origin, self._attitude
        return arrays

    def _make_noise(self) -> DistanceNoise:
        noise, cfg = DistanceNoise(), self.cfg.active_noise
        if cfg is not None:
            for field in fields(cfg):
                setattr(noise, field.name, getattr(cfg, field.name))
        noise.random, noise.image = random_arrays(self._random), wp.from_torch(self._image_number)
        noise.sensor, noise.mounts = self._number, self.num_sensors
        return noise

    def cast(self) -> None:
        """Write the images of the vehicles that are due; launched on torch's current stream, not waited for."""
        if self.cfg.active_noise is not None:
            self._image_number.add_(self.due)
        if self._num_frames > 1:
            self._frame.add_(self.due).remainder_(self._num_frames)
        with interop.on_torch_stream(self.images.distance):
            for launch in self._prepare:
                launch.launch()
            interop.launch_side_by_side(self._launches)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name."""
        places = {"position": self.places.position, "attitude": self.places.attitude}
        frame = {"frame": self._frame} if self._num_frames > 1 else {}
        return {"due": self.due, "image_number": self._image_number, **frame, **places} | dict(self.images.items())

    def reset(self, mask: Tensor) -> None:
        """Reset the mounts of masked vehicles, bool (B,), to nominal or drawn poses; restart image and frame counts."""
        self.places.reset(mask)
        self._image_number.masked_fill_(mask, 0)
        self._frame.masked_fill_(mask, self._num_frames - 1)


def _twist_views(cfg: RangeSensorCfg, carrier: Carrier, count: int, device: torch.device) -> dict[str, wp.array]:
    """Return views of the velocities that a sensor needs, by name."""
    scan = isinstance(cfg, ScannedCfg) and cfg.column_duration_s is not None
    if not (cfg.optical_flow or scan):
        return {}
    if carrier.lin_vel is None or carrier.ang_vel is None:
        name = ("frames" if isinstance(cfg, RosetteCfg) else "scan_s") if scan else "optical_flow"
        raise ConfigError(f"{type(cfg).__name__}.{name} needs lin_vel and ang_vel, the velocities of the body")
    velocities = {"lin_vel": carrier.lin_vel, "ang_vel": carrier.ang_vel}
    return {name: vector_view(name, given, (count, 3), device=device) for name, given in velocities.items()}


def _distance_limits(cfg: RangeSensorCfg) -> DistanceLimits:
    limits = DistanceLimits()
    limits.min_range, limits.max_range = cfg.min_range, cfg.max_range
    limits.projected = cfg.kind == "depth"
    limits.divisor = cfg.max_range if cfg.normalize else 1.0
    limits.near_pixel, limits.far_pixel = cfg.near_pixel, cfg.far_pixel
    if isinstance(cfg, StereoCfg):
        limits.baseline, limits.half_width = cfg.baseline, tan(0.5 * radians(cfg.hfov_deg))
        limits.half_height = limits.half_width * cfg.height / cfg.width
        limits.focal_baseline = 0.5 * cfg.width / limits.half_width * abs(cfg.baseline)
    return limits


def _light_arrays(cfg: RangeSensorCfg, scene: Scene) -> Light:
    light = Light()
    if cfg.light is None:
        return light
    sun, device = cfg.light.sun or (0.0, 0.0, 0.0), wp.device_from_torch(scene.device)
    size = hypot(*sun) or 1.0
    light.sun = wp.vec3(*(part / size for part in sun))
    light.ambient = cfg.light.ambient
    light.sky = wp.vec3(*cfg.light.sky)
    position = [lamp.position for lamp in scene.lamps]
    power = [tuple(lamp.intensity * part for part in lamp.color) for lamp in scene.lamps]
    light.lamp_position = wp.array(np.array(position).reshape(-1, 3), dtype=wp.vec3, device=device)
    light.lamp_power = wp.array(np.array(power).reshape(-1, 3), dtype=wp.vec3, device=device)
    light.looks = scene.shape_table.looks
    return light


def _make_view(scene: Scene, mounts: int, *, vehicles: int) -> SensorView:
    device, count = wp.device_from_torch(scene.device), scene.num_parts
    view = SensorView()
    view.rows = wp.zeros((mounts, 3 * count), dtype=wp.vec4, device=device)
    view.kind = wp.zeros((mounts, count), dtype=wp.int32, device=device)
    view.shapes, view.part_shape, view.vehicles = scene.arrays.shapes, scene.arrays.part_shape, vehicles
    return view
