"""Rotor speeds that follow from the logged commands, for all flights side by side.

Letters: F flights, T rows, R rotors.
"""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.physics.rotors import lag_speed
from aerial_gym.sim2real.flights import Flight

Array = NDArray[np.float64]

REMEMBERED = 8
"""Results kept; a fit asks for few different lags again and again."""


class RotorReplay:
    """Runs the lag of the simulator through the commands, from the first measured speed on, without correction."""

    def __init__(self, flights: Sequence[Flight]) -> None:
        self._groups: dict[float, list[int]] = {}
        for index, flight in enumerate(flights):
            if flight.rotor_command is not None:
                self._groups.setdefault(flight.rate, []).append(index)
        self._flights = flights
        self._results: OrderedDict[tuple[float, ...], list[Array | None]] = OrderedDict()

    def speeds(self, time_constant_up: Tensor, time_constant_down: Tensor, shift: float) -> list[Array | None]:
        """Return speeds [rad/s] of each flight, (T, R); None for a flight without commands.

        Args:
            time_constant_up: Lag of a rising speed [s], (R,).
            time_constant_down: Lag of a falling speed [s], (R,).
            shift: The command of a step lies this share of it towards the next row.
        """
        key = (*time_constant_up.tolist(), *time_constant_down.tolist(), shift)
        if key not in self._results:
            self._results[key] = self._run(time_constant_up, time_constant_down, shift)
            while len(self._results) > REMEMBERED:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        return self._results[key]

    def _run(self, up: Tensor, down: Tensor, shift: float) -> list[Array | None]:
        result: list[Array | None] = [None] * len(self._flights)
        for rate, members in self._groups.items():
            rows = max(self._flights[index].num_rows for index in members)
            command = torch.stack([self._command(index, rows, shift) for index in members], dim=1)  # (T, F, R)
            speed = torch.stack([self._first(index) for index in members])
            history = [speed]
            for row in range(rows - 1):
                history.append(speed := lag_speed(speed, command[row], up, down, 1.0 / rate))
            table = torch.stack(history).numpy()
            for place, index in enumerate(members):
                result[index] = table[: self._flights[index].num_rows, place]
        return result

    def _command(self, index: int, rows: int, shift: float) -> Tensor:
        """Return the commands of a flight, (T, R), the last one repeated to ``rows``."""
        command = self._flights[index].rotor_command
        assert command is not None
        longer = np.concatenate((command, np.repeat(command[-1:], rows - len(command), axis=0)))
        return torch.from_numpy(longer + shift * np.diff(longer, axis=0, append=longer[-1:]))

    def _first(self, index: int) -> Tensor:
        flight = self._flights[index]
        start = flight.rotor_speed if flight.rotor_speed is not None else flight.rotor_command
        assert start is not None
        return torch.from_numpy(start[0].copy())
