"""``aerial-gym bench render``: depth and segmentation of a camera in every environment."""

import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from aerial_gym.config.set_option import SetOption
from aerial_gym.sensors.mounts import Carrier, OwnLinks

if TYPE_CHECKING:
    import torch

    from aerial_gym.config.sensor import RangeSensorCfg


@dataclass(frozen=True, kw_only=True)
class RenderBench:
    """Measure how many images of a scene are rendered per second, and how long moving every obstacle takes."""

    scene: str = "boxes"
    """boxes (floor and 20 boxes, each turned), boxes_aligned, boxes_100, boxes_1000 (all around), clutter (a room
    with 40 obstacles, 8 of them trees), or a registered environment."""

    num_envs: int = 64  # Environments side by side
    vehicles: int = 1  # Vehicles in each of a registered environment's copies: each has a camera that sees the others
    width: int = 64  # Pixels in a row
    height: int = 64  # Pixels in a column
    segmentation: bool = False  # Whether the camera also writes segmentation ids
    lidar: bool = False  # Whether a lidar of a full turn, 45 degrees high, sees the scene instead of the camera
    scan_columns: int | None = None  # Columns of a lidar with one pose, turning in 0.1 s, at 1 m/s; None: all at once

    set: SetOption = ()  # Setting of the camera or lidar, such as sensor.max_range=5; can be repeated

    against: tuple[str, ...] = ()
    """Renderers measured beside ours: merged (one triangle mesh per environment), shared_mesh (one for all, where they
    are alike), newton, mujoco, mujoco_warp; all: every one that is installed and can draw the scene."""

    peer_python: tuple[str, ...] = ()  # NAME=PYTHON, or PYTHON for all: interpreter of a peer; default: this one
    device: str = "auto"  # Torch device; auto takes the GPU if there is one
    threads: int | None = None  # CPU threads; torch's own number if not given, 1 beside others, which have one
    repeats: int = 5  # Figures of which the median is printed
    repeat_time_s: float = 0.5  # About how long each is measured [s]
    json: bool = False  # Print one JSON object a line

    def run(self) -> int:
        """Measure and print; return the exit status: 1 if a peer did not draw the scene."""
        from aerial_gym.workloads.measure import print_figures
        from aerial_gym.workloads.peers import peer_summary

        rows, failures = self.measure()
        print_figures(rows[0], as_json=self.json)
        for row in rows[1:]:
            print_figures(row if self.json else {str(row["name"]): peer_summary(row)}, as_json=self.json)
        for failure in failures:
            print(f"aerial-gym bench render: {failure}", file=sys.stderr)
        return 1 if failures else 0

    def measure(self) -> tuple[list[dict[str, object]], list[str]]:
        """Return the figures with their conditions, a row per peer, and the failures of peers."""
        from aerial_gym.errors import ConfigError
        from aerial_gym.interop import resolve_device
        from aerial_gym.workloads.measure import require_at_least, torch_threads
        from aerial_gym.workloads.peers import renderer_names

        require_at_least(1, num_envs=self.num_envs, vehicles=self.vehicles, width=self.width, height=self.height)
        device, names, threads = resolve_device(self.device), renderer_names(self.against), self.threads
        if names and self.lidar:
            raise ConfigError("--against: the others draw with a camera, not with --lidar")
        if names and device.type == "cpu":
            if threads not in (None, 1):
                raise ConfigError(f"--threads {threads} with --against: others draw with one thread. Use --threads 1")
            threads = 1
        with torch_threads(threads) as used:
            return self._measure(device, names, used)

    def _measure(
        self, device: "torch.device", names: list[str], threads: int
    ) -> tuple[list[dict[str, object]], list[str]]:
        import torch

        from aerial_gym.sensors import RayCaster, SensorImages
        from aerial_gym.workloads.measure import WorkloadError, device_name, provenance, rate_figures
        from aerial_gym.workloads.peers import PeerComparison
        from aerial_gym.workloads.scenes import make_scene

        provided = provenance()
        scene = make_scene(self.scene, self.num_envs, device=device, vehicles=self.vehicles)
        sensor, count = self._sensor_cfg(scene.max_range), self.num_envs * self.vehicles
        image = (count, 1, self.height, self.width)
        depth = torch.zeros(image, device=device)
        ids = torch.zeros(image, dtype=torch.int32, device=device) if self.segmentation else None
        images = SensorImages(distance=depth, segmentation=ids)
        ahead = torch.tensor([1.0, 0.0, 0.0], device=device).repeat(count, 1)
        body = Carrier(position=scene.position, attitude=scene.attitude, lin_vel=ahead, ang_vel=0.0 * ahead)
        caster = RayCaster(sensor, scene.build(), images, body, own=OwnLinks(seen=False))
        seconds = self._call_times(caster.cast, depth)
        elsewhere = scene.state.clone()
        move = statistics.median(self._call_times(lambda: scene.state.copy_(elsewhere), depth))
        comparison = PeerComparison(
            scene=scene, camera=sensor, images=images, direction=caster.direction, pythons=self.peer_python,
            threads=threads, repeats=self.repeats, repeat_time_s=self.repeat_time_s,
        )  # fmt: skip
        peer_results, failures = [], []
        for name in names:
            reason = comparison.refusal_reason(name)
            if reason is not None:
                print(reason, file=sys.stderr)
                continue
            try:
                peer_results.append(comparison.measure(name, self._call_times))
            except WorkloadError as error:
                failures.append(str(error))
            seconds += self._call_times(caster.cast, depth)
        rates = rate_figures("frames_per_s", seconds, count)
        median = rates["frames_per_s"]
        settings = ("num_envs", "vehicles", "width", "height", "segmentation", "lidar", "scan_columns")
        own_row = {
            "case": "render", "name": "aerial_gym", "scene": self.scene, "device": device_name(device),
            **{name: getattr(self, name) for name in settings}, "settings": list(self.set), "threads": threads,
            **rates, "rays_per_s": median * self.width * self.height, "image_s": statistics.median(seconds),
            "move_s": move, **provided,
        }  # fmt: skip
        beside = [{**row, "ratio": median / row["frames_per_s"]} for row in peer_results]  # above 1: ours is faster
        return [own_row, *beside], failures

    def _sensor_cfg(self, max_range: float) -> "RangeSensorCfg":
        """Return the camera or the lidar."""
        from aerial_gym.config.changes import Changes
        from aerial_gym.config.sensor import CameraCfg, LidarCfg
        from aerial_gym.errors import ConfigError

        changes = Changes(self.set)
        if self.scan_columns is not None and not self.lidar:
            raise ConfigError(f"--scan-columns {self.scan_columns}: needs --lidar; a camera does not turn")
        shared = {"width": self.width, "height": self.height, "min_range": 0.0, "max_range": max_range}
        shared |= {"summary": "sensor of bench render", "segmentation": self.segmentation}
        if not self.lidar:
            source = "the depth camera of base_quadrotor_with_camera"
            camera = changes.apply("sensor", CameraCfg(**shared, hfov_deg=87.0, source=source))
            changes.finish()
            return camera
        scan = {} if self.scan_columns is None else {"scan_s": 0.1, "scan_columns": self.scan_columns}
        angles = {"elevation_low_deg": -22.5, "elevation_high_deg": 22.5, "source": "the angles of os1_64"}
        lidar = changes.apply("sensor", LidarCfg(**shared, **scan, **angles))
        changes.finish()
        return lidar

    def _call_times(self, call: "Callable[[], object]", depth: "torch.Tensor") -> list[float]:
        """Return the time of one call in each repeat [s]."""
        from aerial_gym.workloads.measure import time_launches

        return time_launches(_RenderWorkload(call, depth), repeats=self.repeats, repeat_time_s=self.repeat_time_s)


class _RenderWorkload:
    """A workload that writes depth images again and again."""

    batches_per_stretch = 1_000_000_000  # the scene stays: nothing is put back

    def __init__(self, call: "Callable[[], object]", depth: "torch.Tensor") -> None:
        from aerial_gym.workloads.measure import make_batch

        self.device, self._depth = depth.device, depth
        self.launches_per_batch = 4
        self.run_batch = make_batch(lambda: (call(), None)[1], self.launches_per_batch, self.device)

    def restore(self) -> None:
        """Nothing to put back."""

    def check(self, *, started: bool) -> None:
        """Raise ``WorkloadError`` unless every environment sees something, nothing is NaN, and depths differ."""
        from aerial_gym.workloads.measure import WorkloadError

        if not started:
            return
        seen = (self._depth > 0.0).flatten(1).float().mean(dim=1)
        busy = (seen > 0.05).float().mean()
        if not bool(busy > 0.95):  # a camera of an open environment may look away from everything, but not many
            raise WorkloadError(f"{float(busy):.1%} of the cameras see something in 5 % of their pixels: must be 95 %")
        varied = (self._depth.flatten(1).std(dim=1) > 0.01).float().mean()
        if not bool(varied > 0.95):  # a camera may stand in front of a box, but not many
            raise WorkloadError(f"{float(varied):.1%} of the images show more than one depth: must be above 95 %")
