"""Check time stamps of live rows: drop bad ones, and correct a clock that was set back."""

from statistics import median

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.stamps import SPLIT_STEPS
from aerial_gym.sim2real.logs.recording import LONGEST_GAP_S, longest_bridgeable_gap

LATE_START_S = 2.0  # Time before the first accepted row in which a late block may lie [s]
HOLES = 8  # Number of recent time gaps that are remembered
CONFIRMED = 10  # Number of consecutive rows that confirm a start, a gap or a step of the clock


class LiveStamps:
    """Filter of live rows: accept rows whose time continues, hold others until later rows decide, and drop late blocks."""

    def __init__(self) -> None:
        self._steps: list[float] = []
        self._last: float | None = None
        self._shift = 0.0
        self._doubtful: list[Array] = []
        self._holes: list[tuple[float, float]] = []
        self.bad: list[float] = []
        """Rejected stamps so far [s]."""
        self.steps = 0
        """Number of corrected backward steps of the clock."""

    def add_row(self, row: Array, place: int) -> list[Array]:
        """Return the rows that a row with its stamp [s] at index ``place`` confirms as valid, with corrected time."""
        stamp = float(row[place])
        if self._last is not None and 0.0 < stamp - self._last <= self._largest_step:
            self.reject_pending_rows(place)
            return [self._accept_row(row, place)]
        if self._doubtful and not 0.0 < stamp - self._doubtful[-1][place] <= self._largest_step:
            self.reject_pending_rows(place)
        if stamp != stamp:  # NaN
            self.bad.append(stamp)
            return []
        self._doubtful.append(row)
        if len(self._doubtful) < CONFIRMED or self._may_be_late_block(place):
            return []
        good, self._doubtful = self._doubtful, []
        if self._last is not None and good[0][place] <= self._last:
            self._shift += self._last - float(good[0][place]) + (median(self._steps) if self._steps else 0.0)
            self.steps += 1
            self._holes = []
        return [self._accept_row(one, place) for one in good]

    def reject_pending_rows(self, place: int) -> None:
        """Reject the held rows."""
        self.bad += [float(row[place]) for row in self._doubtful]
        self._doubtful = []

    def _may_be_late_block(self, place: int) -> bool:
        """Return whether all held rows lie in one earlier time gap."""
        first, last = float(self._doubtful[0][place]), float(self._doubtful[-1][place])
        return any(start < first and last < stop for start, stop in self._holes)

    @property
    def _largest_step(self) -> float:
        """Return the longest time step that needs no confirmation [s]."""
        return longest_bridgeable_gap(median(self._steps)) if self._steps else LONGEST_GAP_S

    def _accept_row(self, row: Array, place: int) -> Array:
        """Return a valid row with corrected time, and store its stamp."""
        stamp = float(row[place])
        if self._last is None:  # the first rows may follow a gap for a late block
            self._holes = [(stamp - LATE_START_S, stamp)]
        elif self._steps and stamp - self._last > SPLIT_STEPS * median(self._steps):
            self._holes = [*self._holes[1 - HOLES :], (self._last, stamp)]
        if self._last is not None and stamp > self._last:
            self._steps = [*self._steps[-CONFIRMED:], stamp - self._last]
        self._last = stamp
        good = row.copy()
        good[place] = stamp + self._shift
        return good
