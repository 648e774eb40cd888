"""Samples that a log repeats: a sensor slower than the log, packets that came late, a sensor that froze.

While a vehicle moves, no sensor reads exactly the same twice. A repeated value was therefore not measured at its row: it is
replaced by a straight line between the measured ones around it, and the log says so. Letters: T rows.
"""

from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog, rate_of
from aerial_gym.sim2real.logs.signals import interpolated, signs_of

SENSORS = ("position", "attitude", "lin_vel", "ang_vel", "specific_force")
"""What never stands still in flight. Rotor speeds and voltages may: they are measured in coarse steps."""

LONGEST_FROZEN_S = 0.25
"""A sensor that repeats its value for longer than this, while the vehicle moves, is frozen."""

LEAST_WAY = 0.05
"""A pose, measured in steps, is frozen only if the vehicle goes or turns further than this meanwhile [m], [rad]."""

LEAST_MOTION = 0.1
"""Above this speed [m/s] or angular velocity [rad/s] the vehicle moves."""

LEAST_SHARE = 0.005
"""A smaller share of repeated values is not worth a sentence; it is mended all the same."""

MOST_ROWS = 0.5
"""If whole rows repeat in more than this share, the log was written faster than anything was measured."""

REGULAR = 0.8
"""A sensor is slower than the log if this share of its values is held for the same number of rows, or one more or less."""


@dataclass(frozen=True, kw_only=True)
class RepeatedSamples:
    """Which rows of a sensor were measured, and which repeat the one before."""

    fresh: Indices
    """Rows with a new value, the first one included."""

    num_rows: int
    """T."""

    @property
    def share(self) -> float:
        """Return the share of rows that repeat the one before."""
        return 1.0 - self.fresh.size / self.num_rows

    @property
    def usual(self) -> float:
        """Return how many rows a value is usually held: 1, or more if the sensor is slower than the log."""
        spans = np.diff(self.fresh)
        middle = float(np.median(spans)) if spans.size else 1.0
        return float(spans.mean()) if middle > 1.0 and np.mean(np.abs(spans - middle) <= 1.0) >= REGULAR else 1.0


@dataclass(frozen=True, kw_only=True)
class FrozenSensor:
    """A sensor that keeps one value."""

    name: str
    """As in a ``FlightLog``."""

    row: int
    """From which on it does."""

    seconds: float
    """For how long [s]."""


def find_repeated_samples(values: Array, moving: Flags) -> RepeatedSamples:
    """Return the rows (T, any) that are new; what does not move may repeat."""
    same = np.all(values[1:] == values[:-1], axis=1) & moving[1:]
    return RepeatedSamples(fresh=np.flatnonzero(np.concatenate(([True], ~same))), num_rows=len(values))


def mend_repeated_samples(log: FlightLog) -> FlightLog:
    """Return the log with straight lines in place of repeated values, and a note for each sensor that has many.

    Raises:
        DataError: If a sensor was frozen for long, or most of the rows repeat the one before.
    """
    moving = _moving(log)
    sensors = _sensors(log)
    whole = find_repeated_samples(np.concatenate(list(sensors.values()), axis=1), moving)
    if whole.share > MOST_ROWS:
        raise DataError(
            f"{log.path}: {whole.share:.0%} of the rows repeat the one before; write each sample once, at its own t"
        )
    changes: dict[str, object] = {}
    notes = []
    for name, values in sensors.items():
        repeats = find_repeated_samples(values, moving)
        frozen = _longest_frozen(log, name, repeats)
        if frozen.seconds > LONGEST_FROZEN_S:
            raise DataError(
                f"{log.where(frozen.row + 1)}: {name} repeats one value for {frozen.seconds:.3g} s while the vehicle moves; "
                "the sensor was frozen, cut the log there, or leave that sensor out"
            )
        if repeats.share > 0.0:
            changes[name] = interpolated(log.time, log.time[repeats.fresh], values[repeats.fresh])
        if repeats.share > LEAST_SHARE:
            notes.append(_note(log, name, repeats))
    return replace(log, **changes, notes=(*log.notes, *notes))


def _moving(log: FlightLog) -> Flags:
    """Return in which rows the vehicle moves, (T,)."""
    moving = np.zeros(log.time.size, dtype=bool)
    for values in (log.lin_vel, log.ang_vel):
        if values is not None:
            moving |= np.linalg.norm(values, axis=1) > LEAST_MOTION
    return moving


def _sensors(log: FlightLog) -> dict[str, Array]:
    """Return the rows of each sensor that the log has, (T, any) by name; quaternions without jumps of sign."""
    found = {name: getattr(log, name) for name in SENSORS if getattr(log, name) is not None}
    return found | {"attitude": log.attitude * signs_of(log.attitude)[:, None]}


def frozen_sensors(log: FlightLog) -> list[FrozenSensor]:
    """Return the sensors that repeat one value for longer than ``LONGEST_FROZEN_S`` while the vehicle moves."""
    moving = _moving(log)
    sensors = _sensors(log).items()
    found = [_longest_frozen(log, name, find_repeated_samples(values, moving)) for name, values in sensors]
    return [frozen for frozen in found if frozen.seconds > LONGEST_FROZEN_S]


def unchanged_since(log: FlightLog) -> dict[str, int]:
    """Return of each sensor the row from which on it has the value of the last one, whether the vehicle moves or not."""
    found = dict[str, int]()
    for name, values in _sensors(log).items():
        changes = np.flatnonzero(np.any(values[1:] != values[:-1], axis=1))
        found[name] = int(changes[-1]) + 1 if changes.size else 0
    return found


def _longest_frozen(log: FlightLog, name: str, repeats: RepeatedSamples) -> FrozenSensor:
    """Return for how long a sensor keeps one value at most; a pose does only if the vehicle goes or turns meanwhile."""
    ends = np.append(repeats.fresh[1:], repeats.num_rows - 1)
    frozen = log.time[ends] - log.time[repeats.fresh]
    changes = {"position": log.lin_vel, "attitude": log.ang_vel}.get(name)
    if changes is not None:
        way = np.append(0.0, np.cumsum(np.linalg.norm(changes[:-1], axis=1) * np.diff(log.time)))
        frozen = np.where(way[ends] - way[repeats.fresh] > LEAST_WAY, frozen, 0.0)
    worst = int(np.argmax(frozen))
    return FrozenSensor(name=name, row=int(repeats.fresh[worst]), seconds=float(frozen[worst]))


def _note(log: FlightLog, name: str, repeats: RepeatedSamples) -> Finding:
    if repeats.usual > 1.0:
        rate = rate_of(log)
        return Finding("samples_slow", "", {"sensor": name, "rate_hz": rate / repeats.usual, "log_rate_hz": rate})
    longest = int(np.diff(repeats.fresh, append=repeats.num_rows).max()) - 1
    return Finding("samples_repeated", "", {"sensor": name, "share": repeats.share, "longest_rows": longest})
