"""Whether a log holds another one's measurements: a copy, renamed, trimmed or thinned, is no other flight.

Sensors that measure never read the same twice in all their digits, so that rows which agree value by value were measured
once. Time and what may be missing in one of both are not compared. Letters: T rows.
"""

from collections.abc import Sequence

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.recording import FlightLog

READINGS = ("ang_vel", "specific_force", "lin_vel", "position")
"""What is compared; the attitude alone where two logs have none of these in common, for it may be integrated from where a log
begins."""

MOST_SHARED = 0.1
"""Flights of a simulator without noise may begin alike, and sensors in coarse steps may read alike on the ground."""


class SeenLogs:
    """Logs of one run, each held against those before it."""

    def __init__(self) -> None:
        self._logs: list[FlightLog] = []
        self._rows: dict[tuple[str, tuple[str, ...]], frozenset[bytes]] = {}

    def add(self, log: FlightLog) -> None:
        """Take one more log, as it was read.

        Raises:
            DataError: If its rows, or those of an earlier log, stand in the other one.
        """
        for other in self._logs:
            names = [name for name in READINGS if getattr(log, name) is not None and getattr(other, name) is not None]
            mine, others = (self._readings(one, names or ["attitude"]) for one in (log, other))
            share = len(mine & others) / min(len(mine), len(others))
            if share > MOST_SHARED:
                raise DataError(
                    f"{log.path}: {share:.0%} of the measurements are those of {other.path}, value by value, and a copy is no "
                    "other flight; give each flight once, to train or to test"
                )
        self._logs.append(log)

    def _readings(self, log: FlightLog, names: Sequence[str]) -> frozenset[bytes]:
        """Return the different rows of some sensors."""
        key = (log.path, tuple(names))
        if key not in self._rows:
            table = np.ascontiguousarray(np.concatenate([getattr(log, name) for name in names], axis=1))
            self._rows[key] = frozenset(row.tobytes() for row in table)
        return self._rows[key]
