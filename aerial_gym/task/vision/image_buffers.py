"""Buffers of the first range sensor's image, made when a term reads them: nearest distances in cells, encoder latents.

Letters: E environments, L latents.
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import SensorManager
from aerial_gym.sensors.cells import NearestInCells
from aerial_gym.sensors.encoder.file import HOW, Encoder, load_encoder, normalize_image
from aerial_gym.task.terms.observations import CELLS, LARGEST, LATENTS
from aerial_gym.task.values import Values


class ImageBuffers:
    """Declares the buffers ``CELLS``, ``LARGEST`` and ``LATENTS`` of a task, and computes them from each image."""

    def __init__(self, sensors: SensorManager, gtd: GlobalTensorDictionary, *, robot: str, encoder: str | None) -> None:
        """Take the sensors, the dictionary with their images, the robot's name for messages, and the encoder's name.

        The encoder is loaded when a term reads its latents.
        """
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
        largest, empty = self._sensors.casters[name].cfg.distance_scale
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
