"""Windows of flights, each with the start of one rollout. Letters: W windows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import DelayEffect
from aerial_gym.sim2real.arrays import Indices
from aerial_gym.sim2real.logs.flights import Flight

STEP_S = 0.01  # Longest rollout step [s]; at 10 rad/s, Runge-Kutta of order 4 errs by 1e-7 rad per step
WINDOW_EVERY_S = 0.5  # Time between the starts of consecutive windows [s]

FIRST_WINDOW_S = max(e.longest for e in map(EFFECTS.get, EFFECTS) if isinstance(e, DelayEffect))
"""Start of the first window [s], the longest dead time, so that all arriving commands are in the log."""

MOST_WINDOWS = 600  # Most windows; with more the starts are spread over all flights
CLUSTER_S = 4.0  # Span [s] whose windows count as one sample in confidence intervals


@dataclass(frozen=True, kw_only=True)
class RolloutWindows:
    """Starts of rollouts."""

    flight: Indices  # Index of the flight, (W,)
    row: Indices  # Row of the log, (W,)
    cluster: Indices  # Cluster of each window, whose members overlap or follow each other, (W,)


def find_windows(flights: Sequence[Flight], horizon: float) -> RolloutWindows:
    """Return windows of ``horizon`` [s] without rows on the ground in every flight."""
    spans = [max(0.0, float(f.time[-1]) - horizon - STEP_S) for f in flights]
    every = max(WINDOW_EVERY_S, sum(spans) / MOST_WINDOWS)
    parts, cluster = [], 0
    for index, (flight, span) in enumerate(zip(flights, spans, strict=True)):
        starts = np.arange(FIRST_WINDOW_S, span, every)
        rows = np.round(starts * flight.rate).astype(int)
        if flight.on_ground is not None:
            stood = np.concatenate(([0], np.cumsum(flight.on_ground)))
            last = np.minimum(rows + round((horizon + STEP_S) * flight.rate) + 1, flight.num_rows)
            clear = stood[last] == stood[rows]
            starts, rows = starts[clear], rows[clear]
        groups = (starts / CLUSTER_S).astype(int)
        parts.append((np.full(rows.size, index), rows, groups + cluster))
        cluster += int(groups[-1]) + 1 if rows.size else 0
    flight_index, row, clusters = (np.concatenate(part) for part in zip(*parts, strict=True))
    return RolloutWindows(flight=flight_index, row=row, cluster=clusters)


def windows_of_longest_horizon(
    flights: Sequence[Flight], horizons: Sequence[float]
) -> tuple[tuple[float, ...], RolloutWindows]:
    """Return the feasible horizons [s] and the windows of the longest one; raise ``DataError`` if no flight is long enough."""
    for longest in sorted(horizons, reverse=True):
        windows = find_windows(flights, longest)
        if windows.row.size:
            return tuple(h for h in horizons if h <= longest), windows
    raise DataError(f"no flight is airborne for {FIRST_WINDOW_S + min(horizons):g} s at a time, which a rollout needs")
