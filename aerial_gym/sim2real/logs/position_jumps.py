"""Correction of position jumps that no motion explains, as from a satellite receiver or a motion tracker.

``p - ∫ v dt`` is a constant, a slow drift and noise; a jump is a step in it between the half seconds before and after a
row. Its scale comes from the whole flight and the seconds around the row, with Student's t for the heavy tails of
manoeuvres. A position that has jumped mostly returns: if the total offset o is significant, ``-o`` is searched with less
evidence. Letters: T rows.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage
from scipy.integrate import cumulative_trapezoid

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.statistics import FALSE_ALARM_HOURS, student_quantile

HALF_S = 0.5  # Length of the compared spans [s], longer than the gaps of the slowest receivers
LEAP_S = 0.2  # Width of the velocity's median filter [s]
LEAST = 0.1  # Smallest corrected jump [m]; velocity errors over 0.3 s caused 0.06 m in a measured flight
AROUND_S = 3.0  # Time before and after each row from which the local scale is estimated [s]
FREEDOM = 4  # Degrees of freedom of Student's t, chosen rather than estimated
MOST = 20  # Largest number of corrected jumps; with more the position is left unchanged, with a finding

LIMIT = -float(student_quantile(0.5 * HALF_S / (3.0 * 3600.0 * FALSE_ALARM_HOURS), FREEDOM))
"""Threshold of the scaled difference, exceeded without a jump once per ``FALSE_ALARM_HOURS``."""

MAD = 1.4826  # Ratio of standard deviation to median absolute deviation of a normal distribution


@dataclass(frozen=True, kw_only=True)
class PositionOffset:
    """Total displacement of a position by the jumps so far."""

    size: Array = field(default_factory=lambda: np.zeros(3))  # [m], world, (3,)
    variance: Array = field(default_factory=lambda: np.zeros(3))  # [m²], (3,)

    def add_jump(self, jump: "PositionJump") -> "PositionOffset":
        """Return the offset after one more jump."""
        return PositionOffset(size=self.size + jump.size, variance=self.variance + jump.std**2)

    @property
    def is_significant(self) -> bool:
        """Return whether the offset exceeds the uncertainty of jumps that cancel."""
        return bool((np.abs(self.size) > np.maximum(LEAST, LIMIT * np.sqrt(self.variance))).any())


@dataclass(frozen=True, kw_only=True)
class PositionJump:
    """A step of the position within at most ``HALF_S``."""

    first: int  # First row after its beginning
    last: int  # First row after its end
    size: Array  # [m], world, (3,)
    std: Array  # [m], (3,)

    def add_jump(self, other: "PositionJump") -> "PositionJump":
        """Return the sum of both jumps as one."""
        first, last = min(self.first, other.first), max(self.last, other.last)
        return PositionJump(first=first, last=last, size=self.size + other.size, std=np.maximum(self.std, other.std))

    def finding(self, time: Array) -> Finding:
        """Return the finding on this jump, for rows at these times [s]."""
        size = {"size_m": self.size.tolist(), "half_width_m": (1.96 * self.std).tolist()}
        when = {"start_s": float(time[self.first]), "end_s": float(time[self.last])}
        return Finding("position_jump", "", {**size, **when, "moved_back": True})


def mend_position_jumps(log: FlightLog) -> FlightLog:
    """Return the log, at equal time steps, without position jumps, with a finding for each."""
    if log.position is None or log.lin_vel is None:
        return log
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    position, way = log.position, displacement_from_velocity(log.lin_vel, step)
    accepted, offset = list[PositionJump](), PositionOffset()
    while (jump := largest_jump(position - way, step, offset)) is not None:
        accepted.append(jump)
        offset = offset.add_jump(jump)
        if len(accepted) > MOST:
            return replace(log, notes=(*log.notes, Finding("position_jumps_left", "", {"most": MOST})))
        position = np.concatenate((position[: jump.first], position[jump.first :] - jump.size))
    notes = [jump.finding(log.time) for jump in merge_jumps(accepted, round(HALF_S / step))]
    return replace(log, position=position, notes=(*log.notes, *notes)) if accepted else log


def merge_jumps(jumps: Iterable[PositionJump], rows: int) -> list[PositionJump]:
    """Return the jumps in time order, merging those closer than ``rows`` rows."""
    accepted: list[PositionJump] = []
    for jump in sorted(jumps, key=lambda one: one.first):
        if accepted and jump.first - accepted[-1].last < rows:
            jump = accepted.pop().add_jump(jump)
        accepted.append(jump)
    return accepted


def displacement_from_velocity(velocity: Array, step: float) -> Array:
    """Return the displacement (T, 3) [m] by trapezoidal integration of the median-filtered velocity [m/s]."""
    size = 2 * round(0.5 * LEAP_S / step) + 1  # scipy's median of single columns is much faster
    columns = [ndimage.median_filter(column, size=size, mode="nearest") for column in velocity.T.copy()]
    return cumulative_trapezoid(np.stack(columns, axis=1), dx=step, axis=0, initial=0.0)


def largest_jump(left: Array, step: float, offset: PositionOffset) -> PositionJump | None:
    """Return the most significant jump in ``p - ∫ v dt`` (T, 3), else the return by ``offset``; None without one."""
    half = max(3, round(HALF_S / step))
    if len(left) < 8 * half:
        return None
    sizes, scale = jump_sizes_and_scale(left, step)
    rows = np.abs(sizes)
    odd = np.where(rows > LEAST, rows / scale, 0.0)
    place, axis = np.unravel_index(int(np.argmax(odd)), odd.shape)
    if odd[place, axis] <= LIMIT:
        if not offset.is_significant:
            return None
        back = log_odds_of_return(sizes, scale, offset)
        place = int(np.argmax(back))
        if not (rows[place].max() > LEAST and back[place] > np.log(3600.0 * FALSE_ALARM_HOURS / HALF_S)):
            return None
    row = int(place) + half
    return PositionJump(first=row, last=row, size=sizes[place], std=scale[place])


def jump_sizes_and_scale(left: Array, step: float) -> tuple[Array, Array]:
    """Return the step estimates at rows half to T - half, and their scale without jumps, each (T - 2 half + 1, 3) [m]."""
    sizes = step_estimates(left, max(3, round(HALF_S / step)))
    rows = np.abs(sizes)
    overall = MAD * np.median(rows, axis=0)
    near = ndimage.uniform_filter1d(np.minimum(rows, 3.0 * overall), 2 * round(AROUND_S / step) + 1, axis=0)
    return sizes, np.maximum(np.maximum(overall, 1.2533 * near), 1e-9)  # 1.2533: deviation over mean size, normal


def log_odds_of_return(sizes: Array, scale: Array, offset: PositionOffset) -> Array:
    """Return the log odds (T,) of a return by ``-offset`` against no jump, from differences (T, 3) of density t."""
    wide = np.sqrt(scale**2 + offset.variance)
    no_jump, back = (np.log1p((x**2).sum(axis=1) / FREEDOM) for x in (sizes / scale, (sizes + offset.size) / wide))
    return 0.5 * (FREEDOM + 3) * (no_jump - back) + np.log(scale / wide).sum(axis=1)


def step_estimates(left: Array, half: int) -> Array:
    """Return the least-squares step between the rows before and after, with a common slope, (T - 2 half + 1, any)."""
    at = np.arange(2 * half) - half + 0.5
    columns = np.column_stack((np.ones(2 * half), at, at > 0.0))
    weights = np.linalg.pinv(columns)[2]
    return np.stack([np.convolve(column, weights[::-1], mode="valid") for column in left.T], axis=1)
