"""Inputs of terms that are not of one vehicle alone: tensors of its environment, and of all vehicles in it.

Frames: world of each environment, z up; vehicle is the world turned by the yaw. Letters: E environments, V vehicles of each,
B = E V rows, K neighbours.
"""

from typing import TYPE_CHECKING

from torch import Tensor

from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch
from aerial_gym.task.kernels.vehicles import make_nearest_launch
from aerial_gym.task.vehicles.names import ALL, NEAREST

if TYPE_CHECKING:
    from aerial_gym.task.values import Values

BOUNDS = ("env_bounds_min", "env_bounds_max")


class VehicleInputs:
    """Copies of tensors by row, made where a term reads them and brought up to date by ``refresh``."""

    def __init__(self, env: EnvManager) -> None:
        self._env, self._group = env, env.rows
        self.num_vehicles = self._group.kind.count
        self._copies: list[tuple[Tensor, Tensor]] = []  # Target and source, with the same shape by broadcast
        self._launches: list[ReusableLaunch] = []

    def find(self, name: str, values: "Values", reader: str) -> Tensor | None:
        """Return the tensor ``name`` with a row for each vehicle, None if there is none of that name."""
        gtd, shared = self._env.gtd, name in self._env.gtd
        if name in BOUNDS:
            spec, view = gtd.spec(name), self._group.bounds[BOUNDS.index(name)]
            return values.declare(name, (3,), unit=spec.unit, frame=spec.frame, meaning=spec.meaning, view=view)
        if shared:
            spec, source = gtd.spec(name), gtd.plain(name)
            if spec.shape[:1] != ("E",):
                return source
            if spec.shape[:2] == ("E", "V"):
                view = source.flatten(0, 1)
                return values.declare(name, tuple(view.shape[1:]), dtype=view.dtype, meaning=spec.meaning, view=view)
            return self._copy(name, values, source.unsqueeze(1), tuple(source.shape[1:]), spec.meaning)
        if not name.startswith(ALL):
            return None
        key = name.removeprefix(ALL)
        source = values.find(key, reader)
        rows = source.unflatten(0, (-1, 1, self.num_vehicles))
        return self._copy(name, values, rows, tuple(rows.shape[2:]), f"{key} of all vehicles of the environment")

    def _copy(self, name: str, values: "Values", source: Tensor, shape: tuple[int, ...], meaning: str) -> Tensor:
        made = values.declare(name, shape, dtype=source.dtype, meaning=meaning)
        self._copies.append((made.unflatten(0, (-1, self.num_vehicles)), source))
        self._copies[-1][0].copy_(source)
        return made

    def make_nearest(self, values: "Values", reader: str, *, count: int) -> Tensor:
        """Declare and return the buffer ``NEAREST``."""
        if count >= self.num_vehicles:
            raise ConfigError(
                f"{reader}: count = {count}: each vehicle has {self.num_vehicles - 1} others. Give at most that many"
            )
        meaning = f"the {count} nearest vehicles: position and velocity relative to this one, and 1"
        made = values.declare(NEAREST.format(count=count), (7 * count,), frame="vehicle", meaning=meaning)
        keys = ("robot_position", "robot_linvel", "robot_vehicle_orientation")
        position, velocity, level = (self._group.bodies[key] for key in keys)
        self._launches.append(make_nearest_launch(position, velocity, level, num_vehicles=self.num_vehicles, out=made))
        self._launches[-1].launch(made)
        return made

    def refresh(self) -> None:
        """Copy and measure the present values; launched on torch's current stream, not waited for."""
        for target, source in self._copies:
            target.copy_(source)
        for launch in self._launches:
            launch.launch(self._group.state)
