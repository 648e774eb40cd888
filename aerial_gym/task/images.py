"""Image observations of a task: raw images, nearest distances in cells, latents of an encoder.

Raw images are distances, ids or colours as shares of a largest value, in 8, 16 or 32 bits, with history.
Letters: E environments, S sensors, H x W pixels, P numbers of an image (S H W, K times as many with colours), L latents.
"""

from collections.abc import Callable, Mapping

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.task_terms import ImageCfg
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch, start_warp
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import SensorManager
from aerial_gym.sensors.encoder.file import HOW, Encoder, load_encoder, normalize_image
from aerial_gym.sensors.images import NearestInCells
from aerial_gym.task.kernels.frames import make_image_history_kernel
from aerial_gym.task.terms.observations import CELLS, LARGEST, LATENTS
from aerial_gym.task.values import Values

TYPES = {
    "uint8": (torch.uint8, wp.uint8), "float16": (torch.float16, wp.float16), "float32": (torch.float32, wp.float32),
}  # fmt: skip
"""Of torch and of Warp, by the name in a configuration."""


class TaskImages:
    """The images that a task gives, by name, (E, history S, H, W) or with the components of a pixel behind."""

    def __init__(self, cfgs: Mapping[str, ImageCfg], values: Values, sensors: SensorManager) -> None:
        """Declare the images and make their launches; raise ``UnknownNameError`` if the robot has no such image."""
        self.frames: dict[str, Tensor] = {}  # Observed images by name, overwritten by every step
        begun = values.find("begun", "images")
        all_rows, none = torch.ones_like(begun), torch.zeros_like(begun)
        self._kept_alive: list[Tensor] = [begun, all_rows, none]
        self._of_step: list[ReusableLaunch] = []
        self._of_reset: list[ReusableLaunch] = []
        if cfgs:
            start_warp()
        for name, cfg in cfgs.items():
            image = values.find(cfg.key, f"image {name!r}")
            kind, warp_kind = TYPES[cfg.dtype]
            envs, count, *pixels = image.shape
            shape = (cfg.history * count, *pixels)
            frames = values.declare(f"image_{name}", shape, dtype=kind, meaning=f"image {name!r} of the task")
            largest, empty = image_scale(image, cfg, sensors)
            source = wp.int32 if image.dtype == torch.int32 else wp.float32
            flat, target = image.reshape(envs, -1), frames.view(envs, cfg.history, -1)
            scale = (largest, 255.0 if cfg.dtype == "uint8" else 1.0, empty)
            self._kept_alive += [image, frames]
            self.frames[name] = frames
            for launches, mask, new in ((self._of_step, all_rows, none), (self._of_reset, begun, begun)):
                launches.append(
                    ReusableLaunch(
                        make_image_history_kernel(source, warp_kind, cfg.history), dim=tuple(flat.shape),
                        inputs=[flat, mask, new, *scale], outputs=[target], device=image.device,
                    )
                )  # fmt: skip

    def write_frames(self, *, begun: bool) -> None:
        """Write the present images; launched on torch's current stream, not waited for. ``begun``: of the environments whose
        episode has just begun, and as all frames; otherwise of all, as the newest one."""
        for launch in self._of_reset if begun else self._of_step:
            launch.launch(self._kept_alive[0])


def image_scale(image: Tensor, cfg: ImageCfg, sensors: SensorManager) -> tuple[float, float]:
    """Return the value of an image that maps to 1, in its unit, and the share for an empty (negative) pixel."""
    if "depth" in cfg.key or "disparity" in cfg.key:
        own = [name for name in sensors.casters if cfg.key.startswith(f"{name}_")]
        largest, empty = sensors.casters[own[0] if own else next(iter(sensors.casters))].cfg.largest_and_empty_share
    else:
        largest, empty = (255.0 if image.dtype == torch.int32 else 1.0), 0.0
    return (largest if cfg.largest is None else cfg.largest), empty


class ImageBuffers:
    """Declares the buffers ``CELLS``, ``LARGEST`` and ``LATENTS`` of a task, and computes them from each image."""

    def __init__(self, sensors: SensorManager, gtd: GlobalTensorDictionary, *, robot: str, encoder: str | None) -> None:
        """Take the sensors, the dictionary with their images, the robot's name for messages, and the encoder's name. The
        encoder is loaded when a term reads its latents."""
        self._sensors, self._gtd, self._robot, self._name = sensors, gtd, robot, encoder
        self._cells: list[NearestInCells] = []
        self._encoder: Encoder | None = None

    @property
    def buffer_makers(self) -> Mapping[str, Callable[..., Tensor]]:
        """Functions that make these buffers for ``Values``, by name."""
        return {CELLS: self._declare_cells, LARGEST: self._declare_largest, LATENTS: self._declare_latents}

    @torch.no_grad()
    def measure(self) -> None:
        """Write the cells and latents of the present image; launched, not waited for."""
        for cells in self._cells:
            cells.measure()
        if self._encoder is not None:
            self._latents.copy_(self._encoder(normalize_image(self._image, self._cfg)))

    def _first_sensor(self, reader: str) -> str:
        """Return the name of the first range sensor; raise ``ConfigError`` with term and robot if there is none."""
        if not self._sensors.casters:
            raise ConfigError(f"{reader}: robot {self._robot} has no camera or lidar. Choose one with a sensor")
        return next(iter(self._sensors.casters))

    def _declare_cells(self, values: Values, reader: str, *, rows: int, columns: int) -> Tensor:
        name = self._first_sensor(reader)
        largest, empty = self._sensors.casters[name].cfg.largest_and_empty_share
        image = self._gtd["depth_range_pixels"]
        cells = NearestInCells(image, cells=(rows, columns), largest=largest, empty=empty)
        self._cells.append(cells)
        grid = f"{rows} x {columns} cells of the image of {name}"
        meaning = f"smallest distance in each of {grid}, a share of the largest"
        key = CELLS.format(rows=rows, columns=columns)
        return values.declare(key, (rows * columns,), meaning=meaning, view=cells.nearest)

    def _declare_largest(self, values: Values, reader: str) -> Tensor:
        name = self._first_sensor(reader)
        meaning = f"largest distance that {name} measures"
        largest = self._sensors.casters[name].cfg.max_range
        return values.declare(LARGEST, unit="m", meaning=meaning, rows=False).fill_(largest)

    def _declare_latents(self, values: Values, reader: str) -> Tensor:
        sensor = self._first_sensor(reader)
        if self._name is None:
            raise ConfigError(
                f"{reader}: needs an encoder: --encoder FILE, encoder: FILE in a task, or make_task(encoder=...). {HOW}"
            )
        self._image, self._cfg = self._gtd["depth_range_pixels"][:, 0], self._sensors.casters[sensor].cfg
        encoder = load_encoder(self._name, device=self._gtd.device)
        encoder.check_fits(self._cfg, name=sensor, label=f"encoder {self._name}")
        meaning = f"latents of the image of {sensor} by encoder {self._name}"
        self._encoder = encoder
        self._latents = values.declare(LATENTS, (encoder.num_latents,), meaning=meaning)
        return self._latents
