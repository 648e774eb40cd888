"""Detection of duplicated flights: the same measurements in two logs, also renamed, trimmed or thinned.

Independent measurements never agree in all digits. Time and quantities that one log lacks are not compared.
"""

from collections.abc import Sequence

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.recording import FlightLog

READINGS = ("ang_vel", "specific_force", "lin_vel", "position")
"""Compared quantities; the attitude alone if two logs share none, since it may be integrated from the log's start."""

MOST_SHARED = 0.1  # Largest accepted share of equal rows, as of noise-free starts and coarse sensors on the ground


class LogRegister:
    """Logs of one run, each compared with all earlier ones."""

    def __init__(self) -> None:
        self._logs: list[FlightLog] = []
        self._rows: dict[tuple[str, tuple[str, ...]], frozenset[bytes]] = {}

    def add(self, log: FlightLog) -> None:
        """Add a log; raise ``DataError`` if it shares more than ``MOST_SHARED`` of its rows with an earlier one."""
        for other in self._logs:
            names = [name for name in READINGS if getattr(log, name) is not None and getattr(other, name) is not None]
            own_readings, other_readings = (self._distinct_rows(one, names or ["attitude"]) for one in (log, other))
            share = len(own_readings & other_readings) / min(len(own_readings), len(other_readings))
            if share > MOST_SHARED:
                raise DataError(
                    f"{log.path}: {share:.0%} of the measurements are those of {other.path}, value by value, and a copy is no "
                    "other flight; give each flight once, to train or to test"
                )
        self._logs.append(log)

    def _distinct_rows(self, log: FlightLog, names: Sequence[str]) -> frozenset[bytes]:
        """Return the set of distinct rows of the named sensors."""
        key = (log.path, tuple(names))
        if key not in self._rows:
            table = np.ascontiguousarray(np.concatenate([getattr(log, name) for name in names], axis=1))
            self._rows[key] = frozenset(row.tobytes() for row in table)
        return self._rows[key]
