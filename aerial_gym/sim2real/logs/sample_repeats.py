"""Repair of repeated samples, from a sensor slower than the log, a late packet or a frozen sensor.

In motion no sensor reads exactly the same twice. A repeated value was thus not measured at its row: it is replaced by
linear interpolation, with a finding. Letters: T rows.
"""

from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog, StreamTiming, sample_rate
from aerial_gym.sim2real.logs.row_grid import SLOWEST_COMMANDS_HZ, without_slow_rotor_data
from aerial_gym.sim2real.logs.signals import interpolate_columns, quaternion_signs

SENSORS = ("position", "attitude", "lin_vel", "ang_vel", "specific_force")
"""Sensors whose values always vary in flight; rotor speeds and voltages have coarse steps and may not."""

COLUMNS = ("ang_vel", "specific_force", "rotor_speed")  # Sensors of which a single column can freeze
COLUMN_FROZEN_S = (
    1.0  # Least time of one value of a frozen column in motion; estimators and coarse steps repeat shorter
)
CHANCE = 1e-9  # Largest probability by chance of the longest run of one value in a frozen column

LONGEST_FROZEN_S = 0.25  # Longest time of one value in motion; beyond it the sensor is frozen
LEAST_WAY = 0.05  # Least motion [m], [rad] during one value of a frozen pose, which may have coarse steps
LEAST_MOTION = 0.1  # Least speed [m/s] or angular velocity [rad/s] of a moving vehicle
LEAST_SHARE = 0.005  # Smallest reported share of repeated values; smaller ones are repaired silently
MOST_ROWS = 0.5  # Largest share of rows that repeat entirely; beyond it the log rate exceeds all sensor rates
REGULAR = 0.8  # Share of a slow sensor's values that last the median number of rows, plus or minus one


@dataclass(frozen=True, kw_only=True)
class SampleRepeats:
    """Measured rows and repeated rows of one sensor."""

    fresh: Indices  # Rows with a new value, including the first
    num_rows: int  # Number of rows T

    @property
    def share_of_repeats(self) -> float:
        """Return the share of repeated rows."""
        return 1.0 - self.fresh.size / self.num_rows

    @property
    def rows_per_value(self) -> float:
        """Return the mean number of rows per value; 1 unless the sensor is regularly slower than the log."""
        spans = np.diff(self.fresh)
        middle = float(np.median(spans)) if spans.size else 1.0
        return float(spans.mean()) if middle > 1.0 and np.mean(np.abs(spans - middle) <= 1.0) >= REGULAR else 1.0


@dataclass(frozen=True, kw_only=True)
class SensorFreeze:
    """A sensor that repeats one value in motion."""

    name: str  # Field of ``FlightLog``
    row: int  # First row with that value
    seconds: float  # Duration [s]


def find_repeated_samples(values: Array, moving: Flags) -> SampleRepeats:
    """Return the rows (T, any) with new values; a repeat counts only while the vehicle moves."""
    same = np.all(values[1:] == values[:-1], axis=1) & moving[1:]
    return SampleRepeats(fresh=np.flatnonzero(np.concatenate(([True], ~same))), num_rows=len(values))


def mend_repeated_samples(log: FlightLog) -> FlightLog:
    """Return the log with repeated values interpolated, and findings; raise ``DataError`` for frozen sensors or most rows."""
    moving = _is_moving(log)
    sensors = _sensor_rows(log)
    whole = find_repeated_samples(np.concatenate(list(sensors.values()), axis=1), moving)
    if whole.share_of_repeats > MOST_ROWS:
        raise DataError(
            f"{log.path}: {whole.share_of_repeats:.0%} of the rows repeat the one before; write each sample once, at its own t"
        )
    changes: dict[str, Array] = {}
    sampled = dict(log.sample_times)
    timings, notes = dict(log.streams), []
    for name, values in sensors.items():
        repeats = find_repeated_samples(values, moving)
        frozen = _longest_freeze(log, name, repeats)
        if frozen.seconds > LONGEST_FROZEN_S:
            raise DataError(
                f"{log.row_name(frozen.row + 1)}: {name} repeats one value for {frozen.seconds:.3g} s while the vehicle moves; "
                "the sensor was frozen, cut the log there, or leave that sensor out"
            )
        if repeats.share_of_repeats > 0.0:
            changes[name] = interpolate_columns(log.time, log.time[repeats.fresh], values[repeats.fresh])
        if repeats.share_of_repeats > LEAST_SHARE:
            notes.append(_repeat_finding(log, name, repeats))
        if repeats.share_of_repeats > 0.5:
            timings[name] = StreamTiming(source=name, rate=sample_rate(log) * (1.0 - repeats.share_of_repeats))
            sampled[name] = log.time[repeats.fresh]
    for name in COLUMNS:
        if (values := getattr(log, name)) is not None:
            _refuse_frozen_column(log, name, values, moving)
    mended = replace(log, **changes, streams=timings, sample_times=sampled, notes=(*log.notes, *notes))
    return mended if {"rotor_speed", "rotor_command"} & log.streams.keys() else _without_held_rotor_data(mended)


def _refuse_frozen_column(log: FlightLog, name: str, values: Array, moving: Flags) -> None:
    """Raise ``DataError`` for a column that repeats one value in motion for longer than its other repeats make probable.

    With the share p of rows that change outside the longest run of n rows, such a run has the probability ``T (1 - p)^n``.
    """
    for column in range(values.shape[1]):
        fresh = find_repeated_samples(values[:, column : column + 1], moving & (values[:, column] != 0.0)).fresh
        runs = np.diff(fresh, append=len(values))
        longest = int(np.argmax(runs))
        row, rows = int(fresh[longest]), int(runs[longest])
        share = (fresh.size - 1) / max(len(values) - rows, 1)
        seconds = float(log.time[row + rows - 1] - log.time[row])
        if seconds > COLUMN_FROZEN_S and len(values) * (1.0 - min(share, 1.0)) ** rows < CHANCE:
            raise DataError(
                f"{log.row_name(row + 1)}: {name} {column + 1} repeats one value for {seconds:.3g} s while the vehicle moves; "
                "it was frozen, cut the log there, or leave that sensor out"
            )


def _without_held_rotor_data(log: FlightLog) -> FlightLog:
    """Return rows of a text log with rotor data that are slower than ``SLOWEST_COMMANDS_HZ`` interpolated between changes."""
    changes: dict[str, Array] = {}
    timings, step = dict(log.streams), 1.0 / sample_rate(log)
    for name in ("rotor_speed", "rotor_command"):
        values = getattr(log, name)
        if values is None:
            continue
        fresh = find_repeated_samples(values, np.ones(len(values), dtype=bool)).fresh
        rows = float(np.median(np.diff(fresh))) if fresh.size > 1 else 1.0
        if rows > 1.0 and 1.0 / (rows * step) < SLOWEST_COMMANDS_HZ:
            changes[name] = interpolate_columns(log.time, log.time[fresh], values[fresh])
            timings[name] = StreamTiming(source=name, rate=1.0 / (rows * step))
    slow = without_slow_rotor_data(replace(log, **changes), {name: one.rate for name, one in timings.items()})
    return replace(slow, streams=timings)


def _is_moving(log: FlightLog) -> Flags:
    """Return the rows in motion, (T,)."""
    moving = np.zeros(log.time.size, dtype=bool)
    for values in (log.lin_vel, log.ang_vel):
        if values is not None:
            moving |= np.linalg.norm(values, axis=1) > LEAST_MOTION
    return moving


def _sensor_rows(log: FlightLog) -> dict[str, Array]:
    """Return the rows of each logged sensor by name, (T, any); quaternions have continuous signs."""
    freezes = {name: getattr(log, name) for name in SENSORS if getattr(log, name) is not None}
    return freezes | {"attitude": log.attitude * quaternion_signs(log.attitude)[:, None]}


def find_frozen_sensors(log: FlightLog) -> list[SensorFreeze]:
    """Return the sensors that repeat one value in motion for longer than ``LONGEST_FROZEN_S``."""
    moving = _is_moving(log)
    sensors = _sensor_rows(log).items()
    freezes = [_longest_freeze(log, name, find_repeated_samples(values, moving)) for name, values in sensors]
    return [frozen for frozen in freezes if frozen.seconds > LONGEST_FROZEN_S]


def rows_of_last_change(log: FlightLog) -> dict[str, int]:
    """Return the row of each sensor's last change, in motion or not, by sensor name."""
    freezes = dict[str, int]()
    for name, values in _sensor_rows(log).items():
        changes = np.flatnonzero(np.any(values[1:] != values[:-1], axis=1))
        freezes[name] = int(changes[-1]) + 1 if changes.size else 0
    return freezes


def _longest_freeze(log: FlightLog, name: str, repeats: SampleRepeats) -> SensorFreeze:
    """Return the longest time of one value of a sensor; for poses only while the vehicle moves enough."""
    ends = np.append(repeats.fresh[1:], repeats.num_rows - 1)
    frozen = log.time[ends] - log.time[repeats.fresh]
    changes = {"position": log.lin_vel, "attitude": log.ang_vel}.get(name)
    if changes is not None:
        way = np.append(0.0, np.cumsum(np.linalg.norm(changes[:-1], axis=1) * np.diff(log.time)))
        frozen = np.where(way[ends] - way[repeats.fresh] > LEAST_WAY, frozen, 0.0)
    worst = int(np.argmax(frozen))
    return SensorFreeze(name=name, row=int(repeats.fresh[worst]), seconds=float(frozen[worst]))


def _repeat_finding(log: FlightLog, name: str, repeats: SampleRepeats) -> Finding:
    if repeats.rows_per_value > 1.0:
        rate = sample_rate(log)
        return Finding(
            "samples_slow", "", {"sensor": name, "rate_hz": rate / repeats.rows_per_value, "log_rate_hz": rate}
        )
    longest = int(np.diff(repeats.fresh, append=repeats.num_rows).max()) - 1
    return Finding("samples_repeated", "", {"sensor": name, "share": repeats.share_of_repeats, "longest_rows": longest})
