"""How a load that hangs on the vehicle swings along flights: driven by the measured motion of the body origin.

The link hangs still along the apparent gravity of the first half second and is integrated from there, so that a load which
swung when the log began is followed only once that has faded. Letters: N steps.
"""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from torch import Tensor

from aerial_gym.physics.model import STANDARD_GRAVITY, Model
from aerial_gym.sim2real.flights import DERIVED_BAND, Flight
from aerial_gym.sim2real.load_swing import swing
from aerial_gym.sim2real.signals import lowpass

Array = NDArray[np.float64]

STEP_S = 0.04
"""Step of the integrator [s]; Runge-Kutta of order 4 follows a link of 0.3 m, 6 rad/s, to 1e-5 of an angle each step."""

SETTLED_S = 0.5
"""The load hangs still along the mean apparent gravity of this span [s]."""

BAND = 5.0
"""The measured acceleration is taken below it [Hz]; links longer than 0.1 m swing below 2 Hz."""

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
            swings = swing(
                effect, params[0], self._start, self._acceleration, step=STEP_S, gravity=model.gravity
            ).numpy()
            self._results[key] = [
                CubicHermiteSpline(self._time[::2], s[:, :3], s[:, 3:]) for s in swings.swapaxes(0, 1)
            ]
            if len(self._results) > REMEMBERED:
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
