"""Time stamps of a log: late blocks are put in order, rows with a bad stamp left out, and a clock that was set back corrected.

The lateness of row n is ``t - n dt`` with the usual step dt. After a bad stamp it returns to its former level. After a clock
was set back, or its counter wrapped, it stays at a lower level. Letters: T rows, K rows that are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.late_blocks import JOINT_STEPS, find_blocks
from aerial_gym.sim2real.logs.recording import gap_limit

MOST_BAD = 0.25
"""With a larger share of bad stamps, the median of a window no longer tells the right time."""

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
"""Periods [s] after which common clocks begin again at 0; time must then go on by no more than a gap that can be bridged."""

NEAR_ROWS = 5
"""Rows around a stamp that tell whether it is out of order by little."""

PERMANENT = 0.375
"""A clock that was set back by m steps puts 2 m rows out of order and the lateness down by m: half a step for each of them."""

FURTHEST = 0.7
"""Of two neighbours with exchanged stamps both are off by one step, give or take the jitter: both are bad."""

SHOWN = 3
"""Places that a note lists."""


@dataclass(frozen=True, kw_only=True)
class ClockStep:
    """A step back of the clock, and its correction."""

    row: int
    """First row after the step, among the rows that are kept."""

    before: float
    """Last stamp before the step [s]."""

    after: float
    """First stamp after the step [s]."""

    shift: float
    """Added to all later stamps [s]."""

    counter: str
    """Counter that wrapped, a key of ``COUNTERS_S``; empty if the clock was set back by another amount."""

    may_be_restart: bool = False
    """Whether the clock may have restarted: with a wrap, more than ``JOINT_STEPS`` passed between the two rows."""

    def finding(self, unit: str, number: int, topic: str = "") -> Finding:
        """Return the note on this step at a line or sample of some number."""
        values = {"before_s": self.before, "after_s": self.after, "shift_s": self.shift, unit: number}
        values |= {"topic": topic} if topic else {}
        if self.counter:
            restart = {"may_be_restart": self.may_be_restart}
            return Finding("clock_wrapped", "", {"counter": self.counter, **values, **restart})
        return Finding("clock_set_back", "", values)


@dataclass(frozen=True, kw_only=True)
class CheckedStamps:
    """The time of the rows of a log, after bad stamps were found and steps back of the clock corrected."""

    time: Array
    """Increasing [s], (K,)."""

    order: Indices
    """Rows of the log in the order in which they were measured, (T,)."""

    late: Indices
    """First rows, in the log, of the blocks that were written late."""

    kept: Flags
    """Rows with a good stamp, in that order, (T,)."""

    steps: tuple[ClockStep, ...]
    """Steps back of the clock, in order."""

    def late_note(self, places: Sequence[int], topic: str = "") -> list[Finding]:
        """Return the note on late blocks, which begin at some lines or samples; none without any."""
        if not places:
            return []
        values = {"blocks": len(places), "places": list(places[:SHOWN]), "topic": topic}
        return [Finding("blocks_ordered", "", values)]


def seconds_of(stamps: ArrayLike, unit: float) -> Array:
    """Return stamps in seconds, (T,); unsigned integers beyond half their range are negative numbers that wrapped."""
    found = np.asarray(stamps)
    signed = found.view(np.int64) if found.dtype == np.uint64 else found
    return signed.astype(np.float64) * unit


def checked_stamps(stamps: Array, path: str) -> CheckedStamps:
    """Return the time of the rows with a good stamp.

    Args:
        stamps: As logged [s], NaN where a row has none, in the order of the log, (T,).
        path: Name of the log, or of its topic, for messages.

    Raises:
        DataError: If most stamps do not increase, or more than ``MOST_BAD`` of them are bad.
    """
    blocks = find_blocks(stamps, tuple(COUNTERS_S.values()))
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
    kept[rows[_is_far(stamps[rows], rows, step)]] = False
    while (bad := _is_near(stamps[kept], np.flatnonzero(kept), step)).any():
        kept[np.flatnonzero(kept)[bad]] = False
    time, clock_steps = _with_one_clock(stamps, kept, step)
    bad = int(np.sum(~kept)) + len(clock_steps)
    if bad > MOST_BAD * kept.size:
        raise DataError(
            f"{path}: {bad} of {kept.size} time stamps are missing, equal or out of order; write the rows in the order in "
            "which they were measured, each with its own time"
        )
    return CheckedStamps(order=blocks.order, late=blocks.late, time=time, kept=kept, steps=tuple(clock_steps))


def _is_far(stamps: Array, rows: Indices, step: float) -> Flags:
    """Return the stamps (K,) that are off by more than a gap that can be bridged, and out of order or at an end.

    Hampel's filter on the lateness. Source: Davies, Gather (1993), The identification of multiple outliers, JASA 88, section 6.
    """
    limit = gap_limit(step)
    width = min(ceil(limit / step), max(1, (rows.size - 1) // 2))
    late = stamps - step * rows
    off = np.abs(late - ndimage.median_filter(late, size=2 * width + 1, mode="mirror"))
    place = np.arange(rows.size)
    at_end = (place < width) | (place >= rows.size - width)
    far = (off > limit) & (_out_of_order(stamps, width) | at_end)
    good = np.flatnonzero(~far)
    if not good.size:
        return far
    after = np.searchsorted(good, place)  # a bad stamp beside a step of the clock moves the median over the step
    around = good[np.stack((np.maximum(after - 1, 0), np.minimum(after, good.size - 1)))]
    return far & (np.abs(late - late[around]) > limit).all(axis=0)


def _is_near(stamps: Array, rows: Indices, step: float) -> Flags:
    """Return the stamps (K,) that are out of order by little: of those that break it together, the ones furthest off.

    Where the lateness is lower after them than before, the clock was set back, and none of them is bad.
    """
    found, late = np.zeros(rows.size, dtype=bool), stamps - step * rows
    off = np.abs(late - ndimage.median_filter(late, size=2 * NEAR_ROWS + 1, mode="mirror"))
    labels, count = ndimage.label(_out_of_order(stamps, NEAR_ROWS))  # pyright: ignore[reportGeneralTypeIssues]
    for (group,) in ndimage.find_objects(labels)[:count]:
        first, last = max(0, group.start - 1), min(group.stop, rows.size - 1)
        if late[first] - late[last] <= PERMANENT * step * (group.stop - group.start):
            found[group] = off[group] >= FURTHEST * off[group].max()
    return found


def _out_of_order(stamps: Array, width: int) -> Flags:
    """Return the flags (K,) of stamps no later than one of so many before, or no earlier than one of so many after."""
    padded = np.concatenate((np.full(width, -np.inf), stamps, np.full(width, np.inf)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return (windows[: stamps.size].max(axis=1) >= stamps) | (windows[width + 1 :].min(axis=1) <= stamps)


def _with_one_clock(stamps: Array, kept: Flags, step: float) -> tuple[Array, list[ClockStep]]:
    """Return the kept stamps without the steps back of the clock, and these: the row after one comes a usual step later."""
    rows = np.flatnonzero(kept)
    time, found = stamps[rows], list[ClockStep]()
    for row in (np.flatnonzero(np.diff(time) <= 0.0) + 1).tolist():
        before, after = float(stamps[rows[row - 1]]), float(stamps[rows[row]])
        back, passed = before - after, step * float(rows[row] - rows[row - 1])
        counter = next((n for n, period in COUNTERS_S.items() if 0.0 < period - back <= gap_limit(step)), "")
        shift = COUNTERS_S[counter] if counter else back + passed
        time[row:] += shift
        doubt = bool(counter) and shift - back > JOINT_STEPS * passed
        found.append(ClockStep(row=row, before=before, after=after, shift=shift, counter=counter, may_be_restart=doubt))
    return time, found
