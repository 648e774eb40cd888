"""Comparison with other renderers in one run of ``bench render``, on the same scene, rays, device and batch size."""

import statistics
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.sensor import CameraCfg, RangeSensorCfg
from aerial_gym.errors import UnknownNameError
from aerial_gym.sensors import SensorImages
from aerial_gym.workloads.measure import rate_figures
from aerial_gym.workloads.output import format_value
from aerial_gym.workloads.process import absence_reason, interpreters
from aerial_gym.workloads.renderers.runs import (
    MOST_THAT_DIFFER,
    RENDER_PEERS,
    mismatch_share,
    run_peer,
    scene_arrays,
    vertical_field_deg,
)
from aerial_gym.workloads.scene_meshes import DISTINCT, SceneMeshes
from aerial_gym.workloads.scenes import RenderScene

FLAG = "--peer-python"
MESHES = ("merged", "shared_mesh")  # Renderers that come with us: triangle meshes, cast by Warp


def renderer_names(asked: tuple[str, ...]) -> list[str]:
    """Return the names of renderers; ``all`` stands for every one."""
    known = (*MESHES, *RENDER_PEERS)
    for name in asked:
        if name not in (*known, "all"):
            raise UnknownNameError(f"--against {name!r}: no such renderer. Known: all, {', '.join(known)}")
    return [name for name in known if name in asked or "all" in asked]


@dataclass(frozen=True, kw_only=True)
class PeerResult:
    """Measurement of another renderer."""

    name: str
    seconds: list[float]  # Time of all images in each repeat [s]
    differing: float  # Share of pixels that show something else than ours
    more: dict[str, object]  # Versions, triangles

    def row(self, our_frames_per_s: float, num_envs: int) -> dict[str, object]:
        """Return the figures; ``ratio`` above 1: ours is faster."""
        rates = rate_figures("frames_per_s", self.seconds, num_envs)
        return {
            "case": "render_beside",
            "name": self.name,
            **rates,
            "image_s": statistics.median(self.seconds),
            "ratio": our_frames_per_s / rates["frames_per_s"],
            "differing_pixels_share": self.differing,
            **self.more,
        }


def peer_summary(row: Mapping[str, object]) -> str:
    """Return the row of another renderer as a sentence."""
    versions = f"; {format_value(row['versions'])}" if "versions" in row else ""
    return f"{format_value(row['frames_per_s'])} frames/s, ours is {format_value(row['ratio'])} times as fast{versions}"


class PeerComparison:
    """Measurement of other renderers on a rendered scene."""

    def __init__(
        self,
        *,
        scene: RenderScene,
        camera: RangeSensorCfg,
        images: SensorImages,
        direction: Tensor,
        pythons: tuple[str, ...],
        **timing: Any,
    ) -> None:
        """Take our ``images``, the ray table ``direction`` (H, W, 3), and ``threads``, ``repeats`` and ``repeat_time_s``."""
        self._scene, self._camera, self._images, self._direction = scene, camera, images, direction
        self._device, self._timing = direction.device.type, timing
        self._pythons = interpreters(pythons, RENDER_PEERS, default=sys.executable, flag=FLAG)

    def refusal_reason(self, name: str) -> str | None:
        """Return the reason against measuring a renderer, with the remedy; None if it can be measured."""
        if not self._scene.shapes:
            return f"{name} is skipped: it needs a scene of its own kind, such as --scene boxes, not an environment."
        if name == "shared_mesh" and bool((self._scene.state != self._scene.state[:1]).any()):
            return "shared_mesh is skipped: the environments of this scene differ. Use --scene boxes_aligned."
        if name in MESHES:
            return None
        return absence_reason(name, RENDER_PEERS.get(name), self._pythons[name], self._device, flag=FLAG)

    def measure(self, name: str, time: Callable[[Callable[[], object], Tensor], list[float]]) -> PeerResult:
        """Draw, compare with our images, and time; ``time`` returns the time of a call in each repeat [s]."""
        return self._measure_mesh(name, time) if name in MESHES else self._measure_peer(name)

    def _measure_mesh(self, name: str, time: Callable[[Callable[[], object], Tensor], list[float]]) -> PeerResult:
        meshes = SceneMeshes(self._scene, self._direction, shared=name == "shared_mesh")
        meshes.cast()
        count = DISTINCT if name == "merged" else len(meshes.depth)  # the others repeat these
        flat = all(shape.kind == "box" for shape in self._scene.shapes)  # round shapes are drawn as polyhedra
        depth = self._images.distance[:count]
        differing = mismatch_share(name, depth, meshes.depth[:count], most=MOST_THAT_DIFFER if flat else 1.0)
        seconds = time(meshes.cast, meshes.depth)
        return PeerResult(name=name, seconds=seconds, differing=differing, more={"triangles": meshes.num_triangles})

    def _measure_peer(self, name: str) -> PeerResult:
        assert isinstance(self._camera, CameraCfg)
        height = vertical_field_deg(self._camera.hfov_deg, width=self._camera.width, height=self._camera.height)
        ids = self._images.segmentation
        arrays = scene_arrays(self._scene, self._direction, vfov_deg=height, segmentation=ids is not None)
        images = run_peer(name, self._pythons[name], arrays, device=self._device, **self._timing)
        seen = None if images.identity is None else torch.from_numpy(images.identity)
        depth = torch.from_numpy(images.depth)
        differing = mismatch_share(name, self._images.distance, depth, identity=ids, other_identity=seen)
        return PeerResult(name=name, seconds=images.seconds, differing=differing, more={"versions": images.versions})
