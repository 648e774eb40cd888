"""Detection of blocks of rows that a logger wrote late, and of blocks with wrong time stamps.

A late block has right stamps at the wrong place: time jumps ahead, returns to fill the gap, and continues. After a block of
wrong stamps time has advanced by the normal number of steps. A clock that was set back does neither. Letters: T rows.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.logs.recording import longest_bridgeable_gap

JOINT_STEPS = 3.5  # Largest step between consecutive rows, in usual steps; two stamps may be missing
MOST_RUNS = 50  # Largest number of runs searched around a step back; it bounds the run time of disordered logs
SPLIT_STEPS = 2.0  # Step, in usual steps, from which a block may be missing; jitter stays below
MIN_ROWS = 2  # Fewest rows of a block: a single disordered row may be late or have a bad stamp


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
    """Return the runs of at least ``MIN_ROWS`` rows in log order; earlier rows belong to no run."""
    time = stamps[finite]
    joined = (np.diff(time) > 0.0) & (np.diff(time) <= SPLIT_STEPS * step * np.diff(finite))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], joined.astype(int), [0]))))
    spans: list[tuple[int, int]] = []
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
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

    def off(before: int, after: int) -> bool:
        rows = int(runs[after].rows[0]) - runs[before].end
        return abs(runs[after].first - runs[before].last - step * rows) > JOINT_STEPS * step

    first, last = max(0, number - MOST_RUNS), min(len(runs), number + MOST_RUNS)
    ahead = next(
        ((n + 1, number) for n in range(number - 2, first - 1, -1) if off(n, n + 1) and not off(n, number)), None
    )
    behind = None
    if off(number - 1, number):
        behind = next(((number, n) for n in range(number + 1, last) if not off(number - 1, n)), None)
    sizes = {span: sum(run.rows.size for run in runs[slice(*span)]) for span in (ahead, behind) if span}
    return min(sizes, key=sizes.__getitem__, default=None)
