"""Nearest distances in cells of the first range sensor's image, made when a term reads them.

Letters: E environments.
"""

from collections.abc import Callable, Mapping

from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import SensorManager
from aerial_gym.sensors.cells import NearestInCells
from aerial_gym.task.terms.observations import CELLS, LARGEST
from aerial_gym.task.values import Values


class Cells:
    """Declares the buffers ``CELLS`` and ``LARGEST`` of a task, and measures the cells of each image."""

    def __init__(self, sensors: SensorManager, gtd: GlobalTensorDictionary, *, robot: str) -> None:
        """Take the sensors, the dictionary with their images, and what a message calls the robot."""
        self._sensors, self._gtd, self._robot = sensors, gtd, robot
        self._kept: list[NearestInCells] = []

    @property
    def buffer_makers(self) -> Mapping[str, Callable[..., Tensor]]:
        """Return the functions that make this buffer for ``Values``, by its name."""
        return {CELLS: self._cells, LARGEST: self._largest}

    def measure(self) -> None:
        """Write the cells of the present image; launched, not waited for."""
        for cells in self._kept:
            cells.measure()

    def _cells(self, values: Values, reader: str, *, rows: int, columns: int) -> Tensor:
        name = first_sensor(self._sensors, reader, robot=self._robot)
        largest, empty = self._sensors.casters[name].cfg.distance_scale
        image = self._gtd["depth_range_pixels"]
        cells = NearestInCells(image, cells=(rows, columns), largest=largest, empty=empty)
        self._kept.append(cells)
        meaning = (
            f"smallest distance in each of {rows} x {columns} cells of the image of {name}, a share of the largest"
        )
        key = CELLS.format(rows=rows, columns=columns)
        return values.declare(key, (rows * columns,), meaning=meaning, view=cells.nearest)

    def _largest(self, values: Values, reader: str) -> Tensor:
        name = first_sensor(self._sensors, reader, robot=self._robot)
        meaning = f"largest distance that {name} measures"
        largest = self._sensors.casters[name].cfg.max_range
        return values.declare(LARGEST, unit="m", meaning=meaning, rows=False).fill_(largest)


def first_sensor(sensors: SensorManager, reader: str, *, robot: str) -> str:
    """Return the name of the first range sensor; raise ``ConfigError`` with term and robot if there is none."""
    if not sensors.casters:
        raise ConfigError(f"{reader}: robot {robot} has no camera or lidar. Choose one with a sensor")
    return next(iter(sensors.casters))
