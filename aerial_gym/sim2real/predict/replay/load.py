"""Replay of a suspended load along flights, driven by the measured motion of the body origin.

Two angles and two rates at the start are fitted by Gauss-Newton steps to the unexplained specific force of the first 16 s,
with a weak prior of a link at rest along the apparent gravity. So every model with a load receives four numbers per flight.
Letters: N steps, K steps of the initial fit, F flights.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.interpolate import CubicHermiteSpline
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.physics.effects import LoadEffect
from aerial_gym.physics.model import Model
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import DERIVED_BAND, Flight
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.replay.load_swing import integrate_swing

STEP_S = 0.02  # Integration step [s]; RK4 follows 10 rad/s with an error of 3e-6 of the angle per step
SETTLED_S = 0.5  # Span [s] whose mean apparent gravity gives the link's rest direction
BAND = 5.0  # Bandwidth of the measured acceleration [Hz]; links longer than 0.1 m swing below 2 Hz

FOUND_S = (2.0, 4.0, 8.0, 16.0, 16.0)
"""Spans of the initial fit [s], one Gauss-Newton step each; long ones are precise but need a good start. The fixed number
of steps keeps predictions smooth in the parameters."""

FORCE_STD = 0.1  # Standard deviation of the specific force residual [m/s²] in the initial fit
START_STD = (0.3, 0.3, 1.0, 1.0)  # Prior of the initial angles [rad] and rates [rad/s] of a moderate swing
NUDGE = 1e-6  # Finite-difference step of the initial state [rad], [rad/s]
REMEMBERED = 4  # Number of stored results


@dataclass(frozen=True, kw_only=True)
class LoadLink:
    """State of a load's link along one flight."""

    time: Array  # [s], (T,)
    load: Array  # Direction n and rate n' [1/s], world, (T, 6)

    def interpolate_state(self, times: Array) -> Array:
        """Return direction and rate at other times, (W, 6), by linear interpolation with ``|n| = 1``."""
        load = np.stack([np.interp(times, self.time, column) for column in self.load.T], axis=1)
        direction = load[:, :3] / np.linalg.norm(load[:, :3], axis=1, keepdims=True)
        along = (load[:, 3:] * direction).sum(axis=1, keepdims=True)
        return np.concatenate((direction, load[:, 3:] - along * direction), axis=1)


def num_initial_steps(flight: Flight) -> int:
    """Return the number of steps of a flight that fits of the initial link can use."""
    return min(int(np.ceil(float(flight.time[-1]) / STEP_S)) + 1, round(max(FOUND_S) / STEP_S))


class LoadReplay:
    """Replay of the link in all flights for any load parameters."""

    def __init__(self, flights: Sequence[Flight], times: Sequence[Array]) -> None:
        """Load the flights and the times [s] of the requested link states, (rows,) each."""
        self._times = tuple(times)
        self._spans = [float(flight.time[-1]) for flight in flights]
        self._known = all(flight.lin_vel is not None for flight in flights)
        self._results: OrderedDict[tuple[object, ...], Tensor] = OrderedDict()
        self._missed: Sequence[Array] | None = None
        self._felt = torch.empty(0), b""
        if self._known:
            count = int(np.ceil(max(self._spans) / STEP_S)) + 1
            self._time = 0.5 * STEP_S * np.arange(2 * count + 1)
            motion = np.stack([self._origin_acceleration(flight) for flight in flights], axis=1)
            self._acceleration = torch.from_numpy(motion)
            self._start = torch.stack([self._rest_link(place, flight) for place, flight in enumerate(flights)])
            hanging = self._start[:, :3]
            self._axes = torch.linalg.svd(hanging.unsqueeze(1)).Vh.roll(-1, dims=1)  # (F, 3, 3), the link last
            self._axes[:, 2] = hanging
            longest = max(map(num_initial_steps, flights))
            self._num_found = [min(longest, round(span / STEP_S)) for span in FOUND_S]
            grid = self._time[::2][: max(self._num_found) + 1, None]
            self._inside = torch.from_numpy((grid <= np.array(self._spans)).astype(float))

    def link_states(self, model: Model, missed: Sequence[Array] | None = None) -> Tensor:
        """Return direction n and rate n' of the link, world, (E, 6), by the model's first row, in all flights in sequence.

        ``missed``: specific force residual without the load [m/s²], world, (rows, 3) per flight; None: a start at rest.
        """
        effect, params = model.effects[LoadEffect][0]
        felt, numbers = (None, None) if missed is None else self._interpolate_to_steps(missed)
        key = (effect.name, model.gravity, *params[0].tolist(), numbers)
        if key not in self._results:
            start = self._start if felt is None else self._fit_initial_links(model, felt)
            motion = self._acceleration
            swings = integrate_swing(effect, params[0], start, motion, step=STEP_S, gravity=model.gravity)[0].numpy()
            finite = np.isfinite(swings).all(axis=(0, 2))  # not for invalid pendulum parameters, which a fit rejects
            swings[:, ~finite] = 0.0
            self._results[key] = self._interpolate_links_to_rows(swings)
            self._results[key][torch.from_numpy(np.repeat(~finite, list(map(len, self._times))))] = torch.nan
            if len(self._results) > REMEMBERED:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        return self._results[key]

    def _interpolate_links_to_rows(self, swings: Array) -> Tensor:
        """Return direction and rate in the rows of each flight, (E, 6), from those at every step, (N + 1, F, 6)."""
        curves = [CubicHermiteSpline(self._time[::2], s[:, :3], s[:, 3:]) for s in swings.swapaxes(0, 1)]
        parts = [np.concatenate((c(t), c(t, 1)), axis=1) for c, t in zip(curves, self._times, strict=True)]
        load = torch.from_numpy(np.concatenate(parts))
        direction = torch.nn.functional.normalize(load[:, :3], dim=-1)
        rate = load[:, 3:] - (load[:, 3:] * direction).sum(-1, keepdim=True) * direction
        return torch.cat((direction, rate), dim=-1)

    def _origin_acceleration(self, flight: Flight) -> Array:
        """Return the acceleration of the origin every half step [m/s²], world, (2 N + 1, 3)."""
        assert flight.lin_vel is not None
        slow = lowpass(flight.lin_vel, flight.rate, min(BAND, DERIVED_BAND * flight.rate), derivative=True)
        return np.stack([np.interp(self._time, flight.time, column) for column in slow.T], axis=1)

    def _rest_link(self, place: int, flight: Flight) -> Tensor:
        """Return the link at rest along the initial apparent gravity, (6,)."""
        rows = self._time <= min(SETTLED_S, flight.time[-1])
        apparent = -self._acceleration[torch.from_numpy(rows), place].mean(dim=0)
        apparent[2] -= STANDARD_GRAVITY
        return torch.cat((torch.nn.functional.normalize(apparent, dim=0), torch.zeros(3, dtype=apparent.dtype)))

    def _interpolate_to_steps(self, values: Sequence[Array]) -> tuple[Tensor, bytes]:
        """Return values at rows at the first steps, (K + 1, F, 3), 0 after a flight, and their bytes; the last are cached."""
        if values is not self._missed:
            grid = self._time[::2][: max(self._num_found) + 1]
            pairs = zip(self._times, values, strict=True)
            columns = [np.stack([np.interp(grid, t, c, right=0.0) for c in rows.T], axis=1) for t, rows in pairs]
            links = np.stack(columns, axis=1)
            self._missed, self._felt = values, (torch.from_numpy(links), links.tobytes())
        return self._felt

    def _fit_initial_links(self, model: Model, missed: Tensor) -> Tensor:
        """Return the initial links, (F, 6), that best explain the residual ``missed`` (K + 1, F, 3) [m/s²]."""
        effect, params = model.effects[LoadEffect][0]
        num_flights, moved = len(self._spans), torch.zeros(5, len(self._spans), 4, dtype=torch.float64)
        moved[1:] += NUDGE * torch.eye(4, dtype=torch.float64).unsqueeze(1)
        weight = self._inside.unsqueeze(-1) / FORCE_STD  # (K + 1, F, 1)
        prior = torch.tensor(START_STD, dtype=torch.float64).pow(-2)
        side_by_side = self._acceleration[: 2 * max(self._num_found) + 1].repeat(1, 5, 1)
        for count in self._num_found:
            start, acceleration = self._perturb_rest(moved).flatten(0, 1), side_by_side[: 2 * count + 1]
            force = integrate_swing(effect, params[0], start, acceleration, step=STEP_S, gravity=model.gravity)[1]
            pulled = force.unflatten(1, (5, num_flights)) / model.vehicle.mass[0]  # (K + 1, 5, F, 3)
            left = (missed[: count + 1] - pulled[:, 0]) * weight[: count + 1]
            slope = (pulled[:, 1:] - pulled[:, :1]) / NUDGE * weight[: count + 1].unsqueeze(1)
            normal = torch.einsum("kafi,kbfi->fab", slope, slope) + torch.diag(prior)
            pull = torch.einsum("kafi,kfi->fa", slope, left) - prior * moved[0]
            moved = moved + torch.linalg.solve(normal, pull)
        return self._perturb_rest(moved[0])

    def _perturb_rest(self, numbers: Tensor) -> Tensor:
        """Return links (any, F, 6) displaced from rest by two angles and two rates (any, F, 4)."""
        first, second, hanging = self._axes.unbind(1)
        moved = hanging + numbers[..., :1] * first + numbers[..., 1:2] * second
        direction = torch.nn.functional.normalize(moved, dim=-1)
        rate = numbers[..., 2:3] * first + numbers[..., 3:] * second
        return torch.cat((direction, rate - (rate * direction).sum(-1, keepdim=True) * direction), dim=-1)
