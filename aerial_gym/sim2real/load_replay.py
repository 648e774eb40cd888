"""How a load that hangs on the vehicle swings along flights: driven by the measured motion of the body origin.

The link hangs still along the apparent gravity of the first half second and is integrated from there, so that a load which
swung when the log began is followed only once that has faded. Letters: F flights, P parameters, N steps, S sets of parameters.
"""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from torch import Tensor

from aerial_gym.physics.effects import LoadEffect, Suspension
from aerial_gym.physics.model import STANDARD_GRAVITY, Model
from aerial_gym.sim2real.flights import DERIVED_BAND, Flight
from aerial_gym.sim2real.signals import lowpass

Array = NDArray[np.float64]

STEP_S = 0.04
"""Step of the integrator [s]; Runge-Kutta of order 4 follows a link of 0.3 m, 6 rad/s, to 1e-5 of an angle each step."""

SETTLED_S = 0.5
"""The load hangs still along the mean apparent gravity of this span [s]."""

BAND = 5.0
"""The measured acceleration is taken below it [Hz]; links longer than 0.1 m swing below 2 Hz."""

SMALLEST_STEP = 1e-3
"""Difference step in units of a parameter's scale, as ``fit.STEP``: the sets next to one that is asked for are run with it."""

REMEMBERED = 64
"""Results kept."""


class LoadReplay:
    """Directions and rates of the link in all flights, for any parameters of the load."""

    def __init__(self, flights: Sequence[Flight]) -> None:
        self._spans = [float(flight.time[-1]) for flight in flights]
        self._known = all(flight.lin_vel is not None for flight in flights)
        self._results: OrderedDict[tuple[object, ...], list[CubicHermiteSpline]] = OrderedDict()
        if self._known:
            count = int(np.ceil(max(self._spans) / STEP_S)) + 1
            self._time = 0.5 * STEP_S * np.arange(2 * count + 1)
            self._acceleration = torch.from_numpy(np.stack([self._motion(flight) for flight in flights], axis=1))
            self._start = torch.stack([self._hanging(place, flight) for place, flight in enumerate(flights)])

    def loads(self, model: Model, times: Sequence[Array]) -> Tensor:
        """Return direction n and rate n' of the link, world, (E, 6), at times of each flight, one after the other.

        Args:
            model: With the load, which has the same parameters in every row, of which the first is taken.
            times: Of each flight, (rows,); E is their sum.
        """
        effect, params = model.loads[0]
        key = (effect.name, model.gravity, *params[0].tolist())
        if key not in self._results:
            self._run(effect, params[0], model.gravity)
            while len(self._results) > REMEMBERED:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        parts = [np.concatenate((c(t), c(t, 1)), axis=1) for c, t in zip(self._results[key], times, strict=True)]
        load = torch.from_numpy(np.concatenate(parts))
        direction = torch.nn.functional.normalize(load[:, :3], dim=-1)
        rate = load[:, 3:] - (load[:, 3:] * direction).sum(-1, keepdim=True) * direction
        return torch.cat((direction, rate), dim=-1)

    def _motion(self, flight: Flight) -> Array:
        """Return the acceleration of the origin every half step [m/s²], world, (2 N + 1, 3)."""
        assert flight.lin_vel is not None
        slow = lowpass(flight.lin_vel, flight.rate, min(BAND, DERIVED_BAND * flight.rate), derivative=True)
        return np.stack([np.interp(self._time, flight.time, column) for column in slow.T], axis=1)

    def _hanging(self, place: int, flight: Flight) -> Tensor:
        """Return the still link along the apparent gravity at the start of a flight, (6,)."""
        rows = self._time <= min(SETTLED_S, flight.time[-1])
        apparent = -self._acceleration[torch.from_numpy(rows), place].mean(dim=0)
        apparent[2] -= STANDARD_GRAVITY
        return torch.cat((torch.nn.functional.normalize(apparent, dim=0), torch.zeros(3, dtype=apparent.dtype)))

    def _run(self, effect: LoadEffect, params: Tensor, gravity: float) -> None:
        """Keep the swings of a set of parameters, and of those next to it that a derivative will ask for."""
        steps = torch.tensor([SMALLEST_STEP * parameter.scale for parameter in effect.parameters], dtype=params.dtype)
        sets = torch.cat((params.unsqueeze(0), params + torch.diag(steps)))  # (S, P)
        num_sets, num_flights = sets.shape[0], len(self._spans)
        swings = swing(
            effect,
            sets.repeat_interleave(num_flights, dim=0),
            self._start.repeat(num_sets, 1),
            self._acceleration.repeat(1, num_sets, 1),
            gravity,
        ).numpy()
        time = self._time[::2]
        for number, row in enumerate(sets.tolist()):
            rows = range(number * num_flights, (number + 1) * num_flights)
            self._results[(effect.name, gravity, *row)] = [
                CubicHermiteSpline(time, swings[:, k, :3], swings[:, k, 3:]) for k in rows
            ]


def swing(effect: LoadEffect, params: Tensor, start: Tensor, acceleration: Tensor, gravity: float) -> Tensor:
    """Return how links swing below origins that move as given, (N + 1, F, 6), by Runge-Kutta steps of STEP_S.

    Args:
        effect: Gives the equation of motion.
        params: Its parameters, (F, P).
        start: Direction and rate of the link, (F, 6).
        acceleration: Of the origin [m/s²], world, every half step, (2 N + 1, F, 3).
        gravity: Downward acceleration of free fall [m/s²].
    """
    fixed = acceleration.new_zeros(
        params.shape[0], 3, 3
    )  # what pulls at an origin does not move it: its motion is given

    def slope(half: int, load: Tensor) -> Tensor:
        at = Suspension(acceleration=acceleration[half], mobility=fixed, gravity=gravity)
        return torch.cat((load[:, 3:], effect.pull(at, load, params)[1]), dim=-1)

    load, history = start, [start]
    for step in range(acceleration.shape[0] // 2):
        first = slope(2 * step, load)
        second = slope(2 * step + 1, load + 0.5 * STEP_S * first)
        third = slope(2 * step + 1, load + 0.5 * STEP_S * second)
        fourth = slope(2 * step + 2, load + STEP_S * third)
        load = load + STEP_S / 6.0 * (first + 2.0 * (second + third) + fourth)
        direction = torch.nn.functional.normalize(load[:, :3], dim=-1)
        rate = load[:, 3:] - (load[:, 3:] * direction).sum(-1, keepdim=True) * direction
        history.append(load := torch.cat((direction, rate), dim=-1))
    return torch.stack(history)
