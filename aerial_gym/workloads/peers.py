"""Comparison with other renderers in one run of ``bench render``, on the same scene, rays, device and batch size.

A peer is a process of its own: it gets the scene in a file, returns its images in a file, and prints its times.
"""

import json
import math
import statistics
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.config.sensor import CameraCfg, RangeSensorCfg
from aerial_gym.errors import UnknownNameError
from aerial_gym.math.quaternion import quat_from_euler, quat_multiply, quat_rotate
from aerial_gym.registry import Registry
from aerial_gym.sensors import SensorImages
from aerial_gym.workloads.measure import (
    PeerProgram,
    RunFailedError,
    WorkloadError,
    absence_reason,
    format_value,
    interpreters,
    rate_figures,
    run_process,
)
from aerial_gym.workloads.scenes import DISTINCT, RenderScene, SceneMeshes

RENDER_PEERS: Registry[PeerProgram] = Registry("render peer")

for _needs, _install, _devices in (
    (("newton",), "newton", ("cpu", "cuda")),
    (("mujoco",), "mujoco", ("cpu",)),
    (("mujoco_warp", "mujoco"), "mujoco-warp mujoco", ("cpu", "cuda")),
):
    RENDER_PEERS.register(_needs[0], PeerProgram(needs=_needs, install=_install, devices=_devices))

WORKER = Path(__file__).parent / "renderers" / "worker.py"
DEPTH_TOLERANCE = 1e-3  # Largest difference of equal depths [m]; float32 steps are 4e-6 m at 40 m, GPUs lose 2 digits
MOST_THAT_DIFFER = 2e-3  # Largest share of pixels that may differ: round-off decides rays that graze an edge


@dataclass(frozen=True, kw_only=True)
class PeerTimes:
    """Times and images of a peer's process."""

    seconds: list[float]  # Time of all images in each repeat [s]
    depth: np.ndarray  # Along the optical axis [m], -1 for a miss, (E, H, W)
    identity: np.ndarray | None  # Segmentation id of each pixel, -2 for a miss, (E, H, W)
    versions: dict[str, str]  # By package


def run_peer(
    name: str, python: str, scene: dict[str, np.ndarray], *, device: str, threads: int, repeats: int,
    repeat_time_s: float,
) -> PeerTimes:  # fmt: skip
    """Render and time a scene in a separate process, on the CPU pinned to as many cores as threads."""
    numbers = [f"--device={device}", f"--repeats={repeats}", f"--repeat-time-s={repeat_time_s}"]
    with tempfile.TemporaryDirectory() as folder:
        given, taken = Path(folder, "scene.npz"), Path(folder, "images.npz")
        np.savez(given, **scene)  # pyright: ignore[reportArgumentType]
        try:
            said = run_process(
                python,
                [str(WORKER), name, str(given), str(taken), *numbers],
                threads=threads if device == "cpu" else None,
                folder=folder,
            )
        except RunFailedError as error:
            raise WorkloadError(f"{name} failed: {error}") from None
        with np.load(taken) as images:
            depth, identity = images["depth"], images.get("identity")
    return PeerTimes(depth=depth, identity=identity, **json.loads(said))


def mismatch_share(
    name: str, depth: Tensor, other: Tensor, *, identity: Tensor | None = None, other_identity: Tensor | None = None,
    most: float = MOST_THAT_DIFFER,
) -> float:  # fmt: skip
    """Return the share of pixels in which two renderers differ: in depth by more than 1 mm, or in identity, if both are given.

    Depth is in m, below 0 for a miss. A share above ``most`` is more than edges explain: the scenes differ.
    """
    first, second = depth.detach().cpu().flatten(), other.detach().cpu().flatten()
    same = ((first < 0.0) & (second < 0.0)) | ((first - second).abs() <= DEPTH_TOLERANCE)
    if identity is not None and other_identity is not None:
        same &= identity.cpu().flatten() == other_identity.cpu().flatten()
    share = float((~same).double().mean())
    if share > most:
        raise WorkloadError(f"{name} shows something else in {share:.2%} of the pixels: no figure is reported")
    return share


def scene_arrays(
    scene: RenderScene, direction: Tensor, *, vfov_deg: float, segmentation: bool
) -> dict[str, np.ndarray]:
    """Return a scene as ``worker.py`` describes it, compounds taken apart; ``direction`` is the ray table (H, W, 3)."""
    kinds, sizes, ids, places, turns = [], [], [], [], []
    position, attitude = scene.state[..., 0:3].cpu(), scene.state[..., 3:7].cpu()
    for number, shape in enumerate(scene.shapes):
        for part in shape.parts or (PartCfg(shape=shape),):
            at, turn = position[:, number], attitude[:, number]
            offset, own = torch.tensor(part.position), quat_from_euler(torch.tensor(part.euler))
            at, turn = at + quat_rotate(turn, offset.expand_as(at)), quat_multiply(turn, own.expand_as(turn))
            kind, size = part.shape.kind, part.shape.size or (part.shape.radius or 0.0, part.shape.height or 0.0, 0.0)
            if _is_floor(part.shape, at, turn, scene.position.cpu()):
                kind, at = "floor", at + torch.tensor((0.0, 0.0, 0.5 * size[2]))
            kinds.append(kind)
            sizes.append(size)
            ids.append(number)
            places.append(at)
            turns.append(turn)
    arrays = {
        "position": torch.stack(places, dim=1).float(), "attitude": torch.stack(turns, dim=1).float(),
        "camera_position": scene.position, "camera_attitude": scene.attitude, "direction": direction,
    }  # fmt: skip
    return {
        "kind": np.array(kinds),
        "size": np.array(sizes, dtype=np.float32),
        "identity": np.array(ids, dtype=np.int32),
        **{name: array.detach().cpu().numpy() for name, array in arrays.items()},
        "vfov_deg": np.array(vfov_deg),
        "segmentation": np.array(segmentation),
    }


def _is_floor(shape: ShapeCfg, position: Tensor, attitude: Tensor, camera: Tensor) -> bool:
    """Return whether a shape is a level box with only its top face visible to cameras.

    A peer may draw a rectangle instead, which takes MuJoCo half as long.
    """
    if shape.size is None:
        return False
    half = 0.5 * torch.tensor(shape.size)
    above = camera - position
    over = bool((above[:, :2].abs() < half[:2]).all()) and bool((above[:, 2] > half[2]).all())
    return over and bool((attitude[:, 3].abs() == 1.0).all())


FLAG = "--peer-python"
Figures = tuple[list[float], float, dict[str, object]]
MESHES = ("merged", "shared_mesh")  # Renderers that come with us: triangle meshes, cast by Warp


def renderer_names(asked: tuple[str, ...]) -> list[str]:
    """Return the names of renderers; ``all`` stands for every one."""
    known = (*MESHES, *RENDER_PEERS)
    for name in asked:
        if name not in (*known, "all"):
            raise UnknownNameError(f"--against {name!r}: no such renderer. Known: all, {', '.join(known)}")
    return [name for name in known if name in asked or "all" in asked]


def peer_summary(row: Mapping[str, object]) -> str:
    """Return the row of another renderer as a sentence."""
    versions = f"; {format_value(row['versions'])}" if "versions" in row else ""
    return f"{format_value(row['frames_per_s'])} frames/s, ours is {format_value(row['ratio'])} times as fast{versions}"


class PeerComparison:
    """Measurement of other renderers on a rendered scene."""

    def __init__(
        self, *, scene: RenderScene, camera: RangeSensorCfg, images: SensorImages, direction: Tensor,
        pythons: tuple[str, ...], **timing: Any,
    ) -> None:  # fmt: skip
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

    def measure(self, name: str, time: Callable[[Callable[[], object], Tensor], list[float]]) -> dict[str, Any]:
        """Draw, compare with our images, and time; ``time`` returns the time of a call in each repeat [s]."""
        seconds, differing, more = self._measure_mesh(name, time) if name in MESHES else self._measure_peer(name)
        rates = rate_figures("frames_per_s", seconds, len(self._images.distance))
        row = {"case": "render_beside", "name": name, **rates, "image_s": statistics.median(seconds)}
        return {**row, "differing_pixels_share": differing, **more}

    def _measure_mesh(self, name: str, time: Callable[[Callable[[], object], Tensor], list[float]]) -> Figures:
        """Return the time of all images in each repeat [s], the share of pixels that differ from ours, and more figures."""
        meshes = SceneMeshes(self._scene, self._direction, shared=name == "shared_mesh")
        meshes.cast()
        count = DISTINCT if name == "merged" else len(meshes.depth)  # the others repeat these
        flat = all(shape.kind == "box" for shape in self._scene.shapes)  # round shapes are drawn as polyhedra
        depth = self._images.distance[:count]
        differing = mismatch_share(name, depth, meshes.depth[:count], most=MOST_THAT_DIFFER if flat else 1.0)
        seconds = time(meshes.cast, meshes.depth)
        return seconds, differing, {"triangles": meshes.num_triangles}

    def _measure_peer(self, name: str) -> Figures:
        assert isinstance(self._camera, CameraCfg)
        half_height = math.tan(math.radians(self._camera.hfov_deg) / 2.0) * self._camera.height / self._camera.width
        vfov_deg, ids = math.degrees(2.0 * math.atan(half_height)), self._images.segmentation
        arrays = scene_arrays(self._scene, self._direction, vfov_deg=vfov_deg, segmentation=ids is not None)
        images = run_peer(name, self._pythons[name], arrays, device=self._device, **self._timing)
        seen = None if images.identity is None else torch.from_numpy(images.identity)
        depth = torch.from_numpy(images.depth)
        differing = mismatch_share(name, self._images.distance, depth, identity=ids, other_identity=seen)
        return images.seconds, differing, {"versions": images.versions}
