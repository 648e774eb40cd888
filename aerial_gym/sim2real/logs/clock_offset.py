"""The clock of the rotor log: by how much is it ahead of the other sensors?

Letters: T rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog, part_of
from aerial_gym.sim2real.logs.signals import edge_rows, interpolated, lagged, lowpass

LATE_S = 0.003
"""By how much what is logged is late, each sensor by itself [s], a standard deviation: filters and telemetry take some
milliseconds, and no logger writes them down."""

LARGEST_SHIFT_S = 0.05
"""Clock offsets of the rotor log are looked for up to this [s]; measured_data.md 2: 0 to 0.03 s."""

SETTLED = 5.0
"""A lag has forgotten where it began after so many declared time constants."""

LEAST_SHIFT_GAIN = 0.3
"""A shift must take this share off the variance that is left, else the clock is believed. One row of a 100 Hz log or
vertical drag takes off less; an offset of two rows takes off half (seen on the IDSIA flights)."""

AGREEING = 4.0
"""Leads of several logs within this many standard deviations of their mean are the same."""

CLEAR_ODDS = 20.0
"""Where flights do not agree on one clock, an offset must be so many times more probable of one than of late sensors."""

PASSED = 0.85
"""Share of the band whose noise is left between both low-passes: ``7/8 (pi/8) / sin(pi/8)`` of the upper, less 0.05 of it."""


@dataclass(frozen=True, kw_only=True)
class ClockOffset:
    """By how much the rotor log is ahead of the other sensors."""

    rows: float = 0.0
    std: float = 0.0
    """Standard deviation [rows]."""

    def is_a_clock(self, rate: float, odds: float = 1.0) -> bool:
        """Return whether it is more probable of another clock than of two sensors that are late, at ``rate`` [Hz].

        By more than ``odds``. A clock may be off by anything that is looked for; rotor speeds and accelerometer are late each
        by itself.
        """
        spread = float(np.hypot(np.sqrt(2.0) * LATE_S, self.std / rate))
        of_sensors = np.exp(-0.5 * (self.rows / rate / spread) ** 2) / (np.sqrt(2.0 * np.pi) * spread)
        return bool(odds * of_sensors < 0.5 / LARGEST_SHIFT_S)


@dataclass(frozen=True, kw_only=True)
class OffsetCurve:
    """How well a rotor log agrees with the accelerometer, moved by each of some offsets."""

    rate: float
    """Rows per second [Hz]."""

    left: Array
    """Unexplained share of the specific force along z under each offset -N..N [rows], (2 N + 1,); empty: too short."""

    samples: float
    """Independent samples behind it."""

    @property
    def offset(self) -> ClockOffset:
        """Return the offset that agrees best; 0 unless clearly.

        Between rows the least S of ``left`` is that of a parabola, and it is known to ``sqrt(2 S / n S'')`` with n samples.
        """
        if not self.left.size:
            return ClockOffset()
        most = self.left.size // 2
        best = int(np.argmin(self.left))
        # The least at an end of the range is no least: something else grows with the shift.
        if best in (0, 2 * most) or self.left[best] >= min((1.0 - LEAST_SHIFT_GAIN) * self.left[most], 0.5):
            return ClockOffset()
        before, least, after = self.left[best - 1 : best + 2]
        curvature = before - 2.0 * least + after
        least -= (before - after) ** 2 / (8.0 * curvature)
        return ClockOffset(
            rows=float(best - most + 0.5 * (before - after) / curvature),
            std=float(np.sqrt(2.0 * least / (self.samples * curvature))),
        )

    def rules_out(self, rows: float) -> bool:
        """Return whether it clearly agrees better unmoved than under an offset."""
        if not self.left.size:
            return False
        most = self.left.size // 2
        moved = float(np.interp(rows, np.arange(-most, most + 1), self.left))
        return bool(self.left[most] < (1.0 - LEAST_SHIFT_GAIN) * moved)


def offset_curve(
    measured: Array, predicted: Array, others: Array, rate: float, bandwidth: float, *, largest: float = LARGEST_SHIFT_S
) -> OffsetCurve:
    """Return how well a rotor log agrees with the accelerometer, moved by up to ``largest`` [s].

    Thrust explains the specific force along z up to a factor, drag and a shifted centre of mass up to others. Independent
    samples are two per second and hertz of what the filters pass.

    Args:
        measured: Specific force along body z [m/s²], (T,).
        predicted: The same, predicted from the logged rotor speeds, (T,).
        others: What else may act along z, on the clock of the accelerometer, (T, any): velocity, angular acceleration.
        rate: Rows per second [Hz].
        bandwidth: The comparison is made below it and above a twentieth of it [Hz].
        largest: Of the offsets [s].
    """
    most = round(largest * rate)
    wave = np.column_stack((measured, predicted, others))
    wave = lowpass(wave, rate, bandwidth) - lowpass(wave, rate, 0.05 * bandwidth)
    edge = edge_rows(rate, bandwidth) + most
    inner = slice(edge, -edge)
    target = wave[inner, 0]
    if target.size < 4 * edge or not np.any(target):
        return OffsetCurve(rate=rate, left=np.zeros(0), samples=0.0)
    left = np.empty(2 * most + 1)
    for place in range(left.size):
        causes = np.column_stack((np.roll(wave[:, 1], place - most)[inner], wave[inner, 2:]))
        gains = np.linalg.lstsq(causes, target, rcond=None)[0]
        left[place] = np.sum((target - causes @ gains) ** 2) / np.sum(target**2)
    return OffsetCurve(rate=rate, left=left, samples=2.0 * PASSED * bandwidth * target.size / rate)


def common_offsets(found: Sequence[OffsetCurve], learning: int) -> list[ClockOffset]:
    """Return the offset of each of some logs: one that all have, where those that tell it agree, else each its own.

    A logger has one clock: a flight whose thrust hardly varies is moved as the others are, unless its own rules that out.
    The first ``learning`` logs decide on it; the others, which are to judge, may only follow it or keep their own.
    None where sensors may as well be late: that is tolerated of each of them beside every effect, and commands are on time.
    Where those that decide contradict each other, it must be clear: what acts along z may look like an offset in some flights.
    """
    told, agreed = _told_offsets(found, learning)
    odds = 1.0 if agreed else CLEAR_ODDS
    return [
        offset if offset.is_a_clock(one.rate, odds) else ClockOffset() for offset, one in zip(told, found, strict=True)
    ]


def _told_offsets(found: Sequence[OffsetCurve], learning: int) -> tuple[list[ClockOffset], bool]:
    """Return the offset of each log, and whether no log that decides contradicts another one."""
    own = [one.offset for one in found]
    told = list(zip(own, found, strict=True))[:learning]
    known = [(offset.rows / one.rate, offset.std / one.rate) for offset, one in told if offset.std > 0.0]
    if not known:
        return own, True
    time, std = np.array(known).T
    mean, spread = float(np.sum(time / std**2) / np.sum(std**-2)), float(np.sum(std**-2) ** -0.5)
    if np.any(np.abs(time - mean) > AGREEING * std):
        return own, False
    same = [ClockOffset(rows=mean * one.rate, std=spread * one.rate) for one in found]
    each = [
        offset if one.rules_out(moved.rows) or abs(offset.rows - moved.rows) > AGREEING * offset.std > 0.0 else moved
        for offset, moved, one in zip(own, same, found, strict=True)
    ]
    return each, all(offset is moved for offset, moved in zip(each[:learning], same, strict=False))


def commands_share_clock(logs: Sequence[FlightLog], offsets: Sequence[ClockOffset], time_constant: float) -> bool:
    """Return whether commands are on the clock of the rotor speeds, rather than on that of the other sensors.

    A lag is no shift: the clock is the one on which a first-order lag, of any time constant, makes the measured speeds out of
    the commands. Unless the other one leaves clearly less, it is that of the rotor speeds. One answer for all logs: a logger
    has one clock, and an offset of a row is hardly told from a lag by one of them.

    Args:
        logs: With rotor speeds that lead the other sensors by ``offsets``.
        offsets: Of the rotor speeds.
        time_constant: Declared [s]; a fifth to five times of it is tried.
    """
    found = [_left_by_lags(log, offset, time_constant) for log, offset in zip(logs, offsets, strict=True)]
    told = [np.log(moved / stayed) for moved, stayed in filter(None, found)]
    return not told or bool(np.mean(told) > np.log(1.0 - LEAST_SHIFT_GAIN))


def _left_by_lags(log: FlightLog, offset: ClockOffset, time_constant: float) -> tuple[float, float] | None:
    """Return what lags leave of rotor speeds under commands that do not share their clock, and that do; None: nothing tells."""
    speed, command = log.rotor_speed, log.rotor_command
    if round(offset.rows) == 0 or speed is None or command is None:
        return None
    whole = round(offset.rows)
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    edge = round(SETTLED * time_constant / step) + abs(whole)

    def left(shift: int) -> float:
        moved, found = np.roll(command, shift, axis=0), []
        for constant in time_constant * np.geomspace(0.2, 5.0, 17):
            kept = np.exp(-step / constant)
            found.append(np.mean((speed - lagged(moved, kept, speed[0]))[edge:-edge] ** 2))
        return float(min(found))

    return left(-whole), left(0)


def shift_rotor_log(log: FlightLog, offset: ClockOffset, *, commands: bool = True) -> FlightLog:
    """Return the log with rotor speeds, and commands, moved to the later by ``offset``, the ends cut off.

    Between rows they run in a straight line; of a command that is held from row to row this is the mean.
    """
    if offset.rows == 0.0:
        return log
    rows, whole = np.arange(log.time.size, dtype=float), int(np.ceil(abs(offset.rows)))
    kept = slice(whole, None) if offset.rows > 0.0 else slice(0, -whole)
    moved: dict[str, Array] = {}
    for name in ("rotor_speed", "rotor_command")[: 1 + commands]:
        values = getattr(log, name)
        if values is not None:
            moved[name] = interpolated(rows[kept] - offset.rows, rows, values)
    step = 1e3 * float(np.median(np.diff(log.time)))
    lead = {"lead_ms": offset.rows * step, "half_width_ms": 1.96 * offset.std * step, "with_commands": commands}
    note = Finding("rotor_log_moved", "", lead)
    return replace(part_of(log, kept), **moved, notes=(*log.notes, note))
