"""Rotor speeds that follow from the logged commands, for all flights side by side.

Letters: F flights, T rows, R rotors.
"""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.physics.effects import RotorSensorEffect
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

    def speeds(
        self,
        time_constant_up: Tensor,
        time_constant_down: Tensor,
        shift: float,
        sensors: Sequence[tuple[RotorSensorEffect, Tensor]] = (),
    ) -> list[Array | None]:
        """Return speeds [rad/s] of each flight as they are measured, (T, R); None for a flight without commands.

        Args:
            time_constant_up: Lag of a rising speed [s], (R,).
            time_constant_down: Lag of a falling speed [s], (R,).
            shift: The command of a step lies this share of it towards the next row.
            sensors: Errors of the sensors of rotor speed, with parameters (1, P).
        """
        key = (*time_constant_up.tolist(), *time_constant_down.tolist(), shift)
        key += tuple(number for _, params in sensors for number in params[0].tolist())
        if key not in self._results:
            self._results[key] = self._run(time_constant_up, time_constant_down, shift, sensors)
            while len(self._results) > REMEMBERED:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        return self._results[key]

    def _run(
        self, up: Tensor, down: Tensor, shift: float, sensors: Sequence[tuple[RotorSensorEffect, Tensor]]
    ) -> list[Array | None]:
        result: list[Array | None] = [None] * len(self._flights)
        for rate, members in self._groups.items():
            rows = max(self._flights[index].num_rows for index in members)
            command = torch.stack([self._command(index, rows, shift) for index in members], dim=1)  # (T, F, R)
            speed = torch.stack([self._first(index, sensors) for index in members])
            history = [speed]
            for row in range(rows - 1):
                history.append(speed := lag_speed(speed, command[row], up, down, 1.0 / rate))
            table = torch.stack(history)
            for effect, params in sensors:
                table = effect.measure(table, params)
            table = table.numpy()
            for place, index in enumerate(members):
                result[index] = table[: self._flights[index].num_rows, place]
        return result

    def _command(self, index: int, rows: int, shift: float) -> Tensor:
        """Return the commands of a flight, (T, R), the last one repeated to ``rows``."""
        command = self._flights[index].rotor_command
        assert command is not None
        longer = np.concatenate((command, np.repeat(command[-1:], rows - len(command), axis=0)))
        return torch.from_numpy(longer + shift * np.diff(longer, axis=0, append=longer[-1:]))

    def _first(self, index: int, sensors: Sequence[tuple[RotorSensorEffect, Tensor]]) -> Tensor:
        """Return the true speeds at the start, (R,): measured ones without the errors of the sensors, else the commands."""
        flight = self._flights[index]
        if flight.rotor_speed is None:
            assert flight.rotor_command is not None
            return torch.from_numpy(flight.rotor_command[0].copy())
        speed = torch.from_numpy(flight.rotor_speed[:1].copy())
        for effect, params in reversed(sensors):
            speed = effect.true_speed(speed, params)
        return speed[0]
