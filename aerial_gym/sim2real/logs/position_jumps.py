"""Jumps of a logged position that no motion makes: a satellite fix that moves, a tracker that takes one body for another.

What the velocity leaves of the position, ``p - ∫ v dt``, is a constant, a drift of what the velocity is off by, and noise. A
jump is a step in it: the difference between two half seconds before and after, beside one slope. How large such differences
are without a jump, the flight itself says, all of it and the seconds around each row; rows with hard manoeuvres have tails, so
that they are taken as Student's t with few degrees of freedom. A velocity leaps as well, where rows came late: what it does for
a tenth of a second is taken out of it; what it is wrong for longer looks like a jump.

A fix that has jumped mostly returns, and then by as much: where the jumps so far leave a position off by o, as surely as one
jump is told, a difference of ``-o`` is looked for as well. As it is known what it would be, less shows it. Letters: T rows.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.statistics import FALSE_ALARM_HOURS, student_quantile

HALF_S = 0.5
"""What is compared before and after a jump [s]: longer than the gaps of the slowest receivers."""

LEAP_S = 0.2
"""A velocity is the median of so much around each row [s]."""

LEAST = 0.1
"""Smallest jump [m] that is corrected: wrong velocities over 0.3 s made 0.06 m in one measured flight."""

AROUND_S = 3.0
"""Before and after each row differences are taken for how large they are there [s]."""

FREEDOM = 4
"""Degrees of freedom of Student's t: chosen, not estimated."""

MOST = 20
"""A position with more jumps than that is left as it is, and the log says so."""

LIMIT = -float(student_quantile(0.5 * HALF_S / (3.0 * 3600.0 * FALSE_ALARM_HOURS), FREEDOM))
"""What differences without a jump pass, in parts of their scale, once in the hours of a false alarm."""

MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, kw_only=True)
class Offset:
    """By how much the jumps so far have moved a position."""

    size: Array = field(default_factory=lambda: np.zeros(3))
    """[m], world, (3,)."""

    variance: Array = field(default_factory=lambda: np.zeros(3))
    """[m²], (3,)."""

    def and_then(self, jump: "PositionJump") -> "Offset":
        """Return it with one more jump."""
        return Offset(size=self.size + jump.size, variance=self.variance + jump.std**2)

    @property
    def sure(self) -> bool:
        """Return whether it is more than what jumps that took each other back are off by."""
        return bool((np.abs(self.size) > np.maximum(LEAST, LIMIT * np.sqrt(self.variance))).any())


@dataclass(frozen=True, kw_only=True)
class PositionJump:
    """One jump, at once or within ``HALF_S``."""

    first: int
    """The first row after it has begun."""

    last: int
    """The first row after it has ended."""

    size: Array
    """[m], world, (3,)."""

    std: Array
    """[m], (3,)."""

    def and_then(self, other: "PositionJump") -> "PositionJump":
        """Return both as one."""
        first, last = min(self.first, other.first), max(self.last, other.last)
        return PositionJump(first=first, last=last, size=self.size + other.size, std=np.maximum(self.std, other.std))

    def finding(self, time: Array) -> Finding:
        """Return the note on it, for a log with rows at these times [s]."""
        size = {"size_m": self.size.tolist(), "half_width_m": (1.96 * self.std).tolist()}
        when = {"start_s": float(time[self.first]), "end_s": float(time[self.last])}
        return Finding("position_jump", "", {**size, **when, "moved_back": True})


def mend_position_jumps(log: FlightLog) -> FlightLog:
    """Return a log, at equal time steps, without the jumps of its position, and a note for each of them."""
    if log.position is None or log.lin_vel is None:
        return log
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    position, found, way, offset = log.position, list[PositionJump](), integral(log.lin_vel, step), Offset()
    while (jump := largest_jump(position - way, step, offset)) is not None:
        found.append(jump)
        offset = offset.and_then(jump)
        if len(found) > MOST:
            return replace(log, notes=(*log.notes, Finding("position_jumps_left", "", {"most": MOST})))
        position = np.concatenate((position[: jump.first], position[jump.first :] - jump.size))
    notes = [jump.finding(log.time) for jump in joined(found, round(HALF_S / step))]
    return replace(log, position=position, notes=(*log.notes, *notes)) if found else log


def joined(jumps: Iterable[PositionJump], rows: int) -> list[PositionJump]:
    """Return jumps in the order of time, those as one that are fewer than so many rows apart."""
    found: list[PositionJump] = []
    for jump in sorted(jumps, key=lambda one: one.first):
        if found and jump.first - found[-1].last < rows:
            jump = found.pop().and_then(jump)
        found.append(jump)
    return found


def integral(velocity: Array, step: float) -> Array:
    """Return the way (T, 3) [m] that a velocity [m/s] without its leaps has led by each row, trapezium by trapezium."""
    size = 2 * round(0.5 * LEAP_S / step) + 1  # of single columns scipy has a much faster median
    columns = [ndimage.median_filter(column, size=size, mode="nearest") for column in velocity.T.copy()]
    velocity = np.stack(columns, axis=1)
    return np.concatenate((np.zeros((1, 3)), np.cumsum(0.5 * step * (velocity[1:] + velocity[:-1]), axis=0)))


def largest_jump(left: Array, step: float, offset: Offset) -> PositionJump | None:
    """Return the jump that stands out most of what velocities leave of positions (T, 3), None if none does.

    Where none does on its own, one that takes back ``offset``, what the jumps that are already taken out come to.
    """
    half = max(3, round(HALF_S / step))
    if len(left) < 8 * half:
        return None
    sizes, scale = scaled_differences(left, step)
    rows = np.abs(sizes)
    odd = np.where(rows > LEAST, rows / scale, 0.0)
    place, axis = np.unravel_index(int(np.argmax(odd)), odd.shape)
    if odd[place, axis] <= LIMIT:
        if not offset.sure:
            return None
        back = log_odds_of_return(sizes, scale, offset)
        place = int(np.argmax(back))
        if not (rows[place].max() > LEAST and back[place] > np.log(3600.0 * FALSE_ALARM_HOURS / HALF_S)):
            return None
    row = int(place) + half
    return PositionJump(first=row, last=row, size=sizes[place], std=scale[place])


def scaled_differences(left: Array, step: float) -> tuple[Array, Array]:
    """Return the differences of the rows half to T - half, and how large they are without a jump, (T, 3) [m]."""
    sizes = differences(left, max(3, round(HALF_S / step)))
    rows = np.abs(sizes)
    overall = MAD * np.median(rows, axis=0)
    near = ndimage.uniform_filter1d(np.minimum(rows, 3.0 * overall), 2 * round(AROUND_S / step) + 1, axis=0)
    return sizes, np.maximum(np.maximum(overall, 1.2533 * near), 1e-9)  # of a normal distribution: its mean size


def log_odds_of_return(sizes: Array, scale: Array, offset: Offset) -> Array:
    """Return the logarithm of the odds that differences (T, 3) take an offset back against that nothing jumps, (T,).

    Densities of Student's t of three axes whose tails come together: a hard manoeuvre shows in all. Without a jump the odds
    have the mean one, so that they pass c with a probability of at most 1 / c (Markov).
    """
    wide = np.sqrt(scale**2 + offset.variance)
    nothing, back = (np.log1p((x**2).sum(axis=1) / FREEDOM) for x in (sizes / scale, (sizes + offset.size) / wide))
    return 0.5 * (FREEDOM + 3) * (nothing - back) + np.log(scale / wide).sum(axis=1)


def differences(left: Array, half: int) -> Array:
    """Return the step (T - 2 half + 1, any) that least squares put between rows before and after, beside one slope."""
    at = np.arange(2 * half) - half + 0.5
    columns = np.column_stack((np.ones(2 * half), at, at > 0.0))
    weights = np.linalg.pinv(columns)[2]
    return np.stack([np.convolve(column, weights[::-1], mode="valid") for column in left.T], axis=1)
