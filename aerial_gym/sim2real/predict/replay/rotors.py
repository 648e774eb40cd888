"""Rotor speeds from logged commands, for all flights at once.

Letters: F flights, T rows of a flight, N rows of all flights, R rotors.
"""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from aerial_gym.physics import Model
from aerial_gym.physics.effects import CommandEffect, DelayEffect, RotorSensorEffect
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.replay.rotor_commands import target_speeds_with_delay
from aerial_gym.sim2real.predict.replay.rotor_lag import simulate_rotor_lag

REMEMBERED = 8  # Number of stored results; a fit repeats few different lags


class RotorReplay:
    """Open-loop simulation of lag, dead time and battery from the first measured speed and the commands."""

    def __init__(self, flights: Sequence[Flight]) -> None:
        self._flights = flights
        self._members = [index for index, flight in enumerate(flights) if flight.rotor_command is not None]
        rows = [flights[index].num_rows for index in self._members]
        self._ends = torch.from_numpy(np.cumsum([0, *rows], dtype=np.int32))
        self._step = torch.tensor([1.0 / flights[index].rate for index in self._members], dtype=torch.float64)
        self._results: OrderedDict[tuple[object, ...], list[Array | None]] = OrderedDict()

    def speeds(
        self, model: Model, shift: float, sensors: Sequence[tuple[RotorSensorEffect, Tensor]] = ()
    ) -> list[Array | None]:
        """Return the speeds of each flight as a sensor reads them [rad/s], (T, R); None for a flight without commands.

        ``shift``: interpolation of each command towards the next, as a share of a row. ``sensors``: effects on the sensors
        with parameters (1, P). Raise ``DataError`` if a log lacks a quantity that an effect needs.
        """
        vehicle, effects = model.vehicle, (*model.effects[DelayEffect], *model.effects[CommandEffect], *sensors)
        numbers = [vehicle.time_constant_up, vehicle.time_constant_down, vehicle.battery]
        numbers += [params for _, params in effects]
        alike = torch.cat(numbers, dim=1)[0].numpy().tobytes()  # bytes, as an undeclared battery is NaN
        key = (tuple(effect.name for effect, _ in effects), shift, alike)
        if key not in self._results:
            self._results[key] = self._simulate_speeds(model, shift, sensors)
            while len(self._results) > REMEMBERED:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        return self._results[key]

    def _simulate_speeds(
        self, model: Model, shift: float, sensors: Sequence[tuple[RotorSensorEffect, Tensor]]
    ) -> list[Array | None]:
        result: list[Array | None] = [None] * len(self._flights)
        if not self._members:
            return result
        arriving = [target_speeds_with_delay(self._flights[index], model, shift=shift) for index in self._members]
        earlier, later, shares = zip(*arriving, strict=True)
        table = simulate_rotor_lag(
            torch.stack([self._initial_speeds(index, sensors) for index in self._members]),
            torch.cat(earlier),
            torch.cat(later),
            torch.tensor(shares, dtype=torch.float64),
            ends=self._ends,
            step=self._step,
            tau_up=model.vehicle.time_constant_up[0],
            tau_down=model.vehicle.time_constant_down[0],
            slew_rates=(model.vehicle.slew_rate[0], model.vehicle.slew_rate_down[0])
            if model.vehicle.traits & {"slew", "reversible"}
            else None,
        )
        for effect, params in sensors:
            table = effect.measure(table, params)
        for place, index in enumerate(self._members):
            result[index] = table[self._ends[place] : self._ends[place + 1]].numpy()
        return result

    def _initial_speeds(self, index: int, sensors: Sequence[tuple[RotorSensorEffect, Tensor]]) -> Tensor:
        """Return the true initial speeds, (R,): measured, corrected for sensor errors, else the first commands."""
        flight = self._flights[index]
        if flight.rotor_speed is None:
            assert flight.rotor_command is not None
            return torch.from_numpy(flight.rotor_command[0].copy())
        return true_rotor_speed(torch.from_numpy(flight.rotor_speed[:1].copy()), sensors)[0]


def true_rotor_speed(measured: Tensor, sensors: Sequence[tuple[RotorSensorEffect, Tensor]]) -> Tensor:
    """Return measured rotor speeds corrected for sensor errors with parameters (1, P) or of each row."""
    for effect, params in reversed(sensors):
        measured = effect.true_speed(measured, params)
    return measured
