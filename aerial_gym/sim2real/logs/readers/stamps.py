"""Correct time stamps, of a log or row by row: sort late blocks, drop bad stamps, and undo backward steps of the clock.

The lateness of row n is ``t - n dt`` with the usual step dt. After a bad stamp it returns to its level. After a clock
was set back or a counter wrapped, it stays lower. Letters: T rows, K kept rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from statistics import median

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags, Indices, true_spans
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import LONGEST_GAP_S, longest_bridgeable_gap

JOINT_STEPS = 3.5  # Largest step between consecutive rows, in usual steps; two stamps may be missing
MOST_RUNS = 50  # Largest number of runs searched around a step back; it bounds the run time of disordered logs
SPLIT_STEPS = 2.0  # Step, in usual steps, from which a block may be missing; jitter stays below


@dataclass(frozen=True)
class _StampRun:
    """Consecutive rows with increasing stamps, and the rows without a usable stamp after them."""

    first: float
    last: float
    end: int  # Row of ``last``
    rows: Indices


@dataclass(frozen=True, kw_only=True)
class RowBlocks:
    """Disordered rows of a log."""

    order: Indices  # Rows in the order of measurement, (T,)
    late: Indices  # First row of each block that was written late
    wrong: Indices  # Rows in blocks with wrong stamps


def find_disordered_blocks(stamps: Array, periods: tuple[float, ...] = ()) -> RowBlocks:
    """Return the disordered blocks of stamps [s], (T,), NaN where empty; a step back by a wrap period [s] is no late block."""
    order, late, wrong = np.arange(stamps.size), list[int](), [np.zeros(0, dtype=int)]
    finite = np.flatnonzero(np.isfinite(stamps))
    steps = np.diff(stamps[finite])
    if not np.any(steps > 0.0) or np.all(steps > 0.0):
        return RowBlocks(order=order, late=order[:0], wrong=order[:0])
    step = float(np.median(steps[steps > 0.0]))
    runs = _runs_of_increasing_stamps(stamps, finite, step)
    number = 1
    while number < len(runs):
        back = runs[number - 1].last - runs[number].first
        if back < 0.0 or any(0.0 < period - back <= longest_bridgeable_gap(step) for period in periods):
            number += 1
        elif group := _slice_of_exchanged_runs(runs, number, JOINT_STEPS * step):
            start, stop = group
            late.append(int(runs[number].rows[0]))
            runs[start:stop] = sorted(runs[start:stop], key=lambda run: run.first)
            number = stop
        elif group := _slice_of_wrong_runs(runs, number, step):
            start, stop = group
            wrong += [run.rows for run in runs[start:stop]]
            number = stop + 1
        else:
            number += 1
    if late:
        head = order[: int(min(run.rows[0] for run in runs))]
        order = np.concatenate((head, *(run.rows for run in runs)))
    return RowBlocks(order=order, late=np.asarray(late, dtype=int), wrong=np.concatenate(wrong))


def _runs_of_increasing_stamps(stamps: Array, finite: Indices, step: float) -> list[_StampRun]:
    """Return the runs of at least two rows in log order; earlier rows belong to no run."""
    time = stamps[finite]
    joined = (np.diff(time) > 0.0) & (np.diff(time) <= SPLIT_STEPS * step * np.diff(finite))
    spans: list[tuple[int, int]] = []
    for first, last in true_spans(joined):
        previous = spans[-1] if spans else None
        gap = finite[first] - finite[previous[1]] if previous else 0
        if previous and 0.0 < time[first] - time[previous[1]] <= SPLIT_STEPS * step * gap:
            spans[-1] = (previous[0], last)  # only bad stamps between them
        else:
            spans.append((first, last))
    starts = [int(finite[first]) for first, _ in spans]
    stops = [*starts[1:], stamps.size]
    return [
        _StampRun(float(time[first]), float(time[last]), int(finite[last]), np.arange(start, stop))
        for (first, last), start, stop in zip(spans, starts, stops, strict=True)
    ]


def _slice_of_exchanged_runs(runs: list[_StampRun], number: int, joint: float) -> tuple[int, int] | None:
    """Return the slice of runs around a step back whose sorting leaves no overlap and, at an end, no gap; else None."""
    start, stop = number - 1, number + 1
    low, high = runs[number].first, max(runs[start].last, runs[number].last)
    while stop < len(runs) and runs[stop].first <= high and stop - start <= MOST_RUNS:
        low, high = min(low, runs[stop].first), max(high, runs[stop].last)
        stop += 1
    while start > 0 and runs[start - 1].last >= low and stop - start <= MOST_RUNS:
        start -= 1
    group = sorted(runs[start:stop], key=lambda run: run.first)
    gaps = [after.first - before.last for before, after in pairwise(group)]
    if min(gaps) <= 0.0 or len(group) > MOST_RUNS:
        return None
    if stop < len(runs) and runs[stop].first - high > joint:
        return None
    at_end = start == 0 or stop == len(runs)
    if at_end and (max(gaps) > joint or (start > 0 and low - runs[start - 1].last > joint)):
        return None
    return start, stop


def _slice_of_wrong_runs(runs: list[_StampRun], number: int, step: float) -> tuple[int, int] | None:
    """Return the slice of runs, the one with fewer rows, without which time advances one usual step per row; else None."""

    def is_off_clock(before: int, after: int) -> bool:
        rows = int(runs[after].rows[0]) - runs[before].end
        return abs(runs[after].first - runs[before].last - step * rows) > JOINT_STEPS * step

    first, last = max(0, number - MOST_RUNS), min(len(runs), number + MOST_RUNS)
    gaps = (n for n in range(number - 2, first - 1, -1) if is_off_clock(n, n + 1) and not is_off_clock(n, number))
    ahead = next(((n + 1, number) for n in gaps), None)
    behind = None
    if is_off_clock(number - 1, number):
        behind = next(((number, n) for n in range(number + 1, last) if not is_off_clock(number - 1, n)), None)
    sizes = {span: sum(run.rows.size for run in runs[slice(*span)]) for span in (ahead, behind) if span}
    return min(sizes, key=sizes.__getitem__, default=None)


MOST_BAD = 0.25  # Largest share of bad stamps; beyond it a moving median no longer follows the true time

COUNTERS_S = {
    "32 bits of 1 ns": 2**32 * 1e-9,
    "24 bits of 1 us": 2**24 * 1e-6,
    "16 bits of 1 ms": 2**16 * 1e-3,
    "32 bits of 1 us": 2**32 * 1e-6,
    "the minute": 60.0,
    "the hour": 3600.0,
    "the day": 86400.0,
    "the GPS week": 604800.0,
    "32 bits of 1 ms": 2**32 * 1e-3,
}
"""Periods [s] of common counters; after a wrap time must continue within a gap that can be bridged."""

NEAR_ROWS = 5  # Rows on each side that are compared to find slightly disordered stamps
PERMANENT = 0.375  # Least drop of lateness per row, in steps, of a clock set back: m steps disorder 2 m rows
FURTHEST = 0.7  # Share of the worst in their group by which stamps are bad: exchanged stamps are off equally
SHOWN = 3  # Number of places listed in a finding


@dataclass(frozen=True, kw_only=True)
class ClockStep:
    """A backward step of the clock and its correction."""

    row: int  # First kept row after the step
    before: float  # Last stamp before the step [s]
    after: float  # First stamp after the step [s]
    shift: float  # Time added to all later stamps [s]
    counter: str  # Key in ``COUNTERS_S`` of the counter that wrapped; empty if the clock was set back otherwise
    may_be_restart: bool = False  # Whether more than ``JOINT_STEPS`` steps lie between the rows of a wrap

    def finding(self, unit: str, number: int, topic: str = "") -> Finding:
        """Return the finding on this step at a line or sample number."""
        values = {"before_s": self.before, "after_s": self.after, "shift_s": self.shift, unit: number}
        values |= {"topic": topic} if topic else {}
        if self.counter:
            restart = {"may_be_restart": self.may_be_restart}
            return Finding("clock_wrapped", "", {"counter": self.counter, **values, **restart})
        return Finding("clock_set_back", "", values)


@dataclass(frozen=True, kw_only=True)
class StampCorrection:
    """Corrected time of a log without its bad stamps."""

    time: Array  # Increasing [s], (K,)
    order: Indices  # Rows of the log in the order of measurement, (T,)
    late: Indices  # First log row of each block that was written late
    kept: Flags  # Rows with a valid stamp, in that order, (T,)
    steps: tuple[ClockStep, ...]  # Backward steps of the clock in order

    def late_block_findings(self, places: Sequence[int], topic: str = "") -> list[Finding]:
        """Return the finding on late blocks at these lines or samples; empty without any."""
        if not places:
            return []
        values = {"blocks": len(places), "places": list(places[:SHOWN]), "topic": topic}
        return [Finding("blocks_ordered", "", values)]


def stamp_seconds(stamps: ArrayLike, unit: float) -> Array:
    """Return the stamps in seconds, (T,); unsigned integers beyond half their range are wrapped negative numbers."""
    results = np.asarray(stamps)
    signed = results.view(np.int64) if results.dtype == np.uint64 else results
    return signed.astype(np.float64) * unit


def correct_stamps(stamps: Array, path: str) -> StampCorrection:
    """Return the corrected time of the rows with a valid stamp [s], (T,), NaN where empty; ``path``: name for messages.

    Raise ``DataError`` if most stamps do not increase, or more than ``MOST_BAD`` are bad.
    """
    blocks = find_disordered_blocks(stamps, tuple(COUNTERS_S.values()))
    kept = np.isfinite(stamps)
    kept[blocks.wrong] = False
    stamps, kept = stamps[blocks.order], kept[blocks.order]
    kept[1:] &= stamps[1:] != stamps[:-1]  # of equal stamps the first one stands
    rows = np.flatnonzero(kept)
    steps = np.diff(stamps[rows])
    if not steps.size or np.median(steps) <= 0.0:
        raise DataError(
            f"{path}: time does not increase from row to row; write the rows in the order in which they were measured, each "
            "with its own time"
        )
    step = float(np.median(steps[steps > 0.0] / np.diff(rows)[steps > 0.0]))
    kept[rows[_is_far_off(stamps[rows], rows, step)]] = False
    while (bad := _is_slightly_off(stamps[kept], np.flatnonzero(kept), step)).any():
        kept[np.flatnonzero(kept)[bad]] = False
    time, clock_steps = _undo_clock_steps(stamps, kept, step)
    bad = int(np.sum(~kept)) + len(clock_steps)
    if bad > MOST_BAD * kept.size:
        raise DataError(
            f"{path}: {bad} of {kept.size} time stamps are missing, equal or out of order; write the rows in the order in "
            "which they were measured, each with its own time"
        )
    return StampCorrection(order=blocks.order, late=blocks.late, time=time, kept=kept, steps=tuple(clock_steps))


def _is_far_off(stamps: Array, rows: Indices, step: float) -> Flags:
    """Return the stamps (K,) that are off by more than a bridgeable gap, and disordered or at an end.

    Hampel's filter on the lateness. Source: Davies, Gather (1993), The identification of multiple outliers, JASA 88, section 6.
    """
    limit = longest_bridgeable_gap(step)
    width = min(ceil(limit / step), max(1, (rows.size - 1) // 2))
    late = stamps - step * rows
    off = np.abs(late - ndimage.median_filter(late, size=2 * width + 1, mode="mirror"))
    place = np.arange(rows.size)
    at_end = (place < width) | (place >= rows.size - width)
    far = (off > limit) & (_is_out_of_order(stamps, width) | at_end)
    good = np.flatnonzero(~far)
    if not good.size:
        return far
    after = np.searchsorted(good, place)  # beside a clock step, the median may belong to the other side
    around = good[np.stack((np.maximum(after - 1, 0), np.minimum(after, good.size - 1)))]
    return far & (np.abs(late - late[around]) > limit).all(axis=0)


def _is_slightly_off(stamps: Array, rows: Indices, step: float) -> Flags:
    """Return the slightly disordered stamps (K,), furthest off of each group; none if the clock was set back there."""
    results, late = np.zeros(rows.size, dtype=bool), stamps - step * rows
    off = np.abs(late - ndimage.median_filter(late, size=2 * NEAR_ROWS + 1, mode="mirror"))
    labels, count = ndimage.label(_is_out_of_order(stamps, NEAR_ROWS))  # pyright: ignore[reportGeneralTypeIssues]
    for (group,) in ndimage.find_objects(labels)[:count]:
        first, last = max(0, group.start - 1), min(group.stop, rows.size - 1)
        if late[first] - late[last] <= PERMANENT * step * (group.stop - group.start):
            results[group] = off[group] >= FURTHEST * off[group].max()
    return results


def _is_out_of_order(stamps: Array, width: int) -> Flags:
    """Return the stamps (K,) not above all ``width`` stamps before, or not below all ``width`` after."""
    padded = np.concatenate((np.full(width, -np.inf), stamps, np.full(width, np.inf)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return (windows[: stamps.size].max(axis=1) >= stamps) | (windows[width + 1 :].min(axis=1) <= stamps)


def _undo_clock_steps(stamps: Array, kept: Flags, step: float) -> tuple[Array, list[ClockStep]]:
    """Return the kept stamps without backward clock steps, and the steps; time continues by a usual step."""
    rows = np.flatnonzero(kept)
    time, results = stamps[rows], list[ClockStep]()
    for row in (np.flatnonzero(np.diff(time) <= 0.0) + 1).tolist():
        before, after = float(stamps[rows[row - 1]]), float(stamps[rows[row]])
        back, passed = before - after, step * float(rows[row] - rows[row - 1])
        gap = longest_bridgeable_gap(step)
        counter = next((n for n, period in COUNTERS_S.items() if 0.0 < period - back <= gap), "")
        shift = COUNTERS_S[counter] if counter else back + passed
        time[row:] += shift
        doubt = bool(counter) and shift - back > JOINT_STEPS * passed
        results.append(
            ClockStep(row=row, before=before, after=after, shift=shift, counter=counter, may_be_restart=doubt)
        )
    return time, results


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
