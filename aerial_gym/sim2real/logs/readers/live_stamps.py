"""Time stamps of rows that come one by one: bad ones are left out, and a clock that was set back is corrected."""

from statistics import median

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.recording import LONGEST_GAP_S, gap_limit

CONFIRMED = 10
"""So many rows that go on from each other show that the first rows, a gap, or a step of the clock are real."""


class LiveStamps:
    """Passes on the rows whose time goes on; holds the others until the rows after them tell which clock is right."""

    def __init__(self) -> None:
        """Begin without a row."""
        self._steps: list[float] = []
        self._last: float | None = None
        self._shift = 0.0
        self._doubtful: list[Array] = []
        self.bad: list[float] = []
        """Bad stamps so far [s]."""
        self.steps = 0
        """Times that the clock was set back so far."""

    def add(self, row: Array, place: int) -> list[Array]:
        """Return the rows that are known to be good after one more, with corrected time.

        Args:
            row: Its values.
            place: Index of its time stamp [s] among them.
        """
        stamp = float(row[place])
        if self._last is not None and 0.0 < stamp - self._last <= self._limit:
            self.end(place)
            return [self._passed(row, place)]
        if self._doubtful and not 0.0 < stamp - self._doubtful[-1][place] <= self._limit:
            self.end(place)
        if stamp != stamp:  # NaN
            self.bad.append(stamp)
            return []
        self._doubtful.append(row)
        if len(self._doubtful) < CONFIRMED:
            return []
        good, self._doubtful = self._doubtful, []
        if self._last is not None and good[0][place] <= self._last:
            self._shift += self._last - float(good[0][place]) + (median(self._steps) if self._steps else 0.0)
            self.steps += 1
        return [self._passed(one, place) for one in good]

    def end(self, place: int) -> None:
        """Leave out the rows that nothing confirms."""
        self.bad += [float(row[place]) for row in self._doubtful]
        self._doubtful = []

    @property
    def _limit(self) -> float:
        """Return the longest gap that needs no confirmation [s]."""
        return gap_limit(median(self._steps)) if self._steps else LONGEST_GAP_S

    def _passed(self, row: Array, place: int) -> Array:
        """Return a good row with corrected time, and remember its stamp."""
        stamp = float(row[place])
        if self._last is not None and stamp > self._last:
            self._steps = [*self._steps[-CONFIRMED:], stamp - self._last]
        self._last = stamp
        good = row.copy()
        good[place] = stamp + self._shift
        return good
