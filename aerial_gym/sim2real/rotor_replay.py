"""Rotor speeds that follow from the logged commands, for all flights side by side.

Letters: F flights, T rows of a flight, N rows of all flights, R rotors.
"""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.physics.effects import RotorSensorEffect
from aerial_gym.sim2real.flights import Flight
from aerial_gym.sim2real.rotor_lag import follow_commands

Array = NDArray[np.float64]

REMEMBERED = 8
"""Results kept; a fit asks for few different lags again and again."""


class RotorReplay:
    """Runs the lag of the simulator through the commands, from the first measured speed on, without correction."""

    def __init__(self, flights: Sequence[Flight]) -> None:
        self._flights = flights
        self._members = [index for index, flight in enumerate(flights) if flight.rotor_command is not None]
        rows = [flights[index].num_rows for index in self._members]
        self._ends = torch.from_numpy(np.cumsum([0, *rows], dtype=np.int32))
        self._step = torch.tensor([1.0 / flights[index].rate for index in self._members], dtype=torch.float64)
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
        if not self._members:
            return result
        command = torch.cat([self._command(index, shift) for index in self._members])
        first = torch.stack([self._first(index, sensors) for index in self._members])
        table = follow_commands(
            first,
            command,
            command,
            torch.zeros_like(self._step),
            ends=self._ends,
            step=self._step,
            tau_up=up,
            tau_down=down,
        )
        for effect, params in sensors:
            table = effect.measure(table, params)
        for place, index in enumerate(self._members):
            result[index] = table[self._ends[place] : self._ends[place + 1]].numpy()
        return result

    def _command(self, index: int, shift: float) -> Tensor:
        """Return the commands of a flight, (T, R), each moved towards the next one."""
        command = self._flights[index].rotor_command
        assert command is not None
        return torch.from_numpy(command + shift * np.diff(command, axis=0, append=command[-1:]))

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
