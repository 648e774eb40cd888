"""Instances of a controller's library, one copy for each environment, as the firmware's state is in static variables.

The loop over instances is one call of C each. Letters: E environments.
"""

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from ctypes import CDLL, c_float, c_void_p
from functools import partial
from pathlib import Path

import numpy as np

from aerial_gym.errors import ConfigError

INPUTS = {"position": 3, "attitude": 4, "lin_vel": 3, "rate": 3, "force": 3, "goal": 4}
"""Widths of the input, in the order of ``struct input`` in ``host.c``: those of IMU and state, and wanted position and yaw."""


class ControllerGroup:
    """Copies of a library that ``build_controller`` makes."""

    def __init__(self, library: Path, parameters: Mapping[str, float], num_envs: int) -> None:
        """Start the instances with parameters by ``group.name``.

        Raises:
            ConfigError: If the firmware has no such parameters.
        """
        self.inputs = np.zeros((num_envs, sum(INPUTS.values())), np.float32)
        self.motors = np.zeros((num_envs, 4), np.uint16)  # Commands of m1 to m4, 0 to 65535
        ends = np.cumsum([0, *INPUTS.values()])
        self.input = {name: self.inputs[:, i:j] for name, i, j in zip(INPUTS, ends[:-1], ends[1:], strict=True)}
        self._folder = tempfile.TemporaryDirectory(prefix="aerial_gym_crazyflie_")
        self._parameters, self._libraries = parameters, dict[int, CDLL]()
        self._runs: list[Callable[[], int]] = [int] * num_envs
        for env in range(num_envs):
            shutil.copyfile(library, self._path(env))
        self.start(range(num_envs))

    def _path(self, env: int) -> Path:
        return Path(self._folder.name) / f"{env}.so"

    def start(self, envs: Sequence[int]) -> None:
        """Start instances again, as after power-up."""
        for env in envs:
            self._unload(env)
            library = self._libraries[env] = CDLL(str(self._path(env)))
            library.host_start()
            unknown = [name for name, value in self._parameters.items() if not _set(library, name, value)]
            if unknown:
                raise ConfigError(*(f"the firmware has no parameter {name}. Take another version" for name in unknown))
            pointers = (c_void_p(table[env].ctypes.data) for table in (self.inputs, self.motors))
            self._runs[env] = partial(library.host_run, *pointers)

    def run(self) -> None:
        """Run all instances for a millisecond, from ``inputs`` to ``motors``."""
        for run in self._runs:
            run()

    def _unload(self, env: int) -> None:
        if (library := self._libraries.pop(env, None)) is not None:
            CDLL(None).dlclose(c_void_p(library._handle))

    def close(self) -> None:
        """Unload all instances and remove their folder."""
        for env in tuple(self._libraries):
            self._unload(env)
        self._folder.cleanup()


def _set(library: CDLL, name: str, value: float) -> int:
    group, _, key = name.partition(".")
    return library.host_set(group.encode(), key.encode(), c_float(value))
