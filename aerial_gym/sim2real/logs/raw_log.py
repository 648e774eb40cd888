"""The content of a log file as it was recorded: topics at their own rates, parameters and messages. Letters: T samples."""

from collections import UserDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FrameOrigin

LOWEST_BATTERY_V = 1.0  # A voltage below that of any cell means that no battery is measured
MOST_GROWTH, FREE_BYTES = 24, 2**27  # A file may grow to so many times its size when decoded, and to 128 MB at least
FASTER = 1.5  # Ratio of rates from which the faster of two topics with one quantity is taken


class LazyColumns(UserDict[str, Any]):
    """Columns that functions compute at each use, so that only those in use fill memory."""

    def __getitem__(self, name: str) -> Array:
        return self.data[name]()


@dataclass(frozen=True, kw_only=True)
class Topic:
    """Samples of one source, such as one sensor or one estimator, on one clock."""

    name: str  # Name in the file, such as ``vehicle_attitude``, ``IMU`` or ``/dji_sdk/imu``
    instance: int = 0  # Number among the topics of one name
    time: Array  # Recorded time [s], in file order and not yet checked, (T,)
    columns: Mapping[str, Array]  # Values by field name, in the units and frames of the file, each (T,)
    units: Mapping[str, str] = field(default_factory=dict)  # Unit by field name, where the file or its format states it

    @property
    def source(self) -> str:
        """Name with the instance, such as ``vehicle_attitude[0]``."""
        return f"{self.name}[{self.instance}]"

    def numbers(self, *fields: str, unit: float = 1.0) -> Array:
        """Return fields side by side, times a unit, (T, fields)."""
        values = np.empty((self.time.size, len(fields)))
        for place, name in enumerate(fields):
            values[:, place] = self.columns[name]
        values *= unit
        return values

    def channel(self, quantity: str, values: Array, notes: tuple[Finding, ...] = ()) -> "LogChannel":
        """Return a quantity with the stamps of this topic."""
        return LogChannel(quantity=quantity, time=self.time, values=values, source=self.source, notes=notes)


@dataclass(frozen=True, kw_only=True)
class LogMessage:
    """A text that the firmware logged."""

    time: float  # [s]
    level: str  # ``debug``, ``info``, ``warning`` or ``error``
    text: str

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {"time_s": self.time, "level": self.level, "text": self.text}


@dataclass(frozen=True, kw_only=True)
class LogParameterChange:
    """A parameter that was set while the log was written."""

    time: float  # [s]
    name: str
    before: float | str | None  # Value until then; None if none is known
    value: float | str

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {"time_s": self.time, "name": self.name, "before": self.before, "value": self.value}


@dataclass(frozen=True, kw_only=True)
class RawLog:
    """All content of a log file that has been decoded."""

    path: str
    format: str  # Name of the reader in ``LOG_READERS``
    topics: tuple[Topic, ...]
    parameters: Mapping[str, float | str] = field(default_factory=dict)  # Last values or header entries by name
    parameter_changes: tuple[LogParameterChange, ...] = ()  # In the order of time
    messages: tuple[LogMessage, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)  # Firmware, hardware, vehicle and others, for display
    notes: tuple[Finding, ...] = ()  # Defects that decoding has met

    def topic_instances(self, name: str, *fields: str) -> list[Topic]:
        """Return the topics of a name that hold the fields, by instance."""
        topics = (topic for topic in self.topics if topic.name == name and set(fields) <= topic.columns.keys())
        return sorted(topics, key=lambda topic: topic.instance)

    def batteries(self, name: str, field: str) -> Iterator[tuple[Topic, Array]]:
        """Yield the topics of a name that measure a voltage, with its values (T, 1)."""
        for topic in self.topic_instances(name, field):
            voltage = topic.numbers(field)
            if np.median(voltage) > LOWEST_BATTERY_V:
                yield topic, voltage

    def parameters_in_force(self, time: float) -> dict[str, float | str]:
        """Return the parameters in force at a time [s]."""
        later = {one.name: one.before for one in reversed(self.parameter_changes) if one.time > time}
        return {name: value for name, value in {**self.parameters, **later}.items() if value is not None}

    def number(self, name: str, default: float) -> float:
        """Return a parameter; the default if it is missing, text or no finite number."""
        value = self.parameters.get(name, default)
        return float(value) if not isinstance(value, str) and isfinite(value) else default


QUANTITIES = {
    "attitude": 4, "position": 3, "lin_vel": 3, "ang_vel": 3, "specific_force": 3, "rotor_speed": 0,
    "rotor_command": 0, "battery": 1, "armed": 1, "landed": 1,
}  # fmt: skip
"""Number of components of each quantity of a log channel; 0: the number of rotors."""

STATES = ("armed", "landed")  # Quantities that are no measurements of motion

SETPOINTS = {
    "position_setpoint": 3,  # [m], world
    "velocity_setpoint": 3,  # [m/s], world
    "yaw_setpoint": 1,  # Heading [rad], world
    "attitude_setpoint": 4,
    "rate_setpoint": 3,  # Body rates [rad/s], body
    "thrust_setpoint": 1,  # Collective thrust command as a share of the largest, before the firmware's thrust curve
    "specific_thrust_setpoint": 1,  # Collective thrust per mass [m/s²]
}
"""Number of components of each setpoint; its samples keep their own times."""

NO_MOTION = (*STATES, *SETPOINTS)  # Quantities that neither limit nor split a flight


@dataclass(frozen=True, kw_only=True)
class LogChannel:
    """A quantity of the vehicle from one topic, at its own rate: SI units, world ENU, body FLU, quaternions xyzw.

    ``rotor_command`` is a share of the largest rotor speed, 0 to 1, after the firmware's thrust curve. ``armed`` and ``landed``
    are 1 or 0 from each sample on.
    """

    quantity: str  # A key of ``QUANTITIES``
    time: Array  # Sampling time [s] on the clock of the file, not yet checked, (T,)
    values: Array  # (T, components); NaN where not measured
    source: str  # Topic and instance, such as ``vehicle_attitude[0]``
    resets: Array | None = None  # Times [s] of the first sample after an estimator reset, (number of resets,)
    latency: float | None = (
        None  # Delay from sampling to recording [s], if the format states both; ``time`` is the former
    )
    origin: FrameOrigin | None = None  # Of the frame of a position that is local to the estimator
    notes: tuple[Finding, ...] = ()  # Conversions that rest on an assumption, such as an integrated attitude


def apply_parameter_records(
    records: Iterable[tuple[float, str, object]], first: Mapping[str, object]
) -> tuple[dict[str, float | str], tuple[LogParameterChange, ...]]:
    """Return the last values of parameters and their changes, from records (time [s], name, value) after the first values.

    What is no finite number, as in a damaged log, becomes text.
    """

    def number_or_text(value: object) -> float | str:
        return value if isinstance(value, int | float) and isfinite(value) else str(value)

    values, changes = {name: number_or_text(value) for name, value in first.items()}, list[LogParameterChange]()
    for time, name, record in records:
        if values.get(name) != (value := number_or_text(record)):
            changes.append(LogParameterChange(time=time, name=name, before=values.get(name), value=value))
        values[name] = value
    return values, tuple(changes)


def read_records(data: NDArray[np.uint8], places: Indices, record: np.dtype[Any]) -> NDArray[Any]:
    """Return the records that begin at places of a file, (T,)."""
    rows = np.empty((places.size, record.itemsize), dtype=np.uint8)
    for column in range(record.itemsize):
        rows[:, column] = data[places + column]
    return rows.view(record)[:, 0]


def whole_records_in_chain(places: Indices, ends: Indices, size: int) -> NDArray[np.bool_]:
    """Return the records of a file that follow each other: one ends where another one, or nothing, begins.

    ``places`` and ``ends``: bytes at which data that look like a record begin and would end, some within other records.
    """
    following = np.searchsorted(places, ends)
    whole = (ends == size) | (np.append(places, -1)[following] == ends)
    return _places_along_chain(np.where(whole, following, np.arange(1, places.size + 1))) & whole


def _places_along_chain(steps: Indices) -> NDArray[np.bool_]:
    """Return the places that are visited from place 0 on, where each states the next one."""
    visited = np.zeros(steps.size, dtype=bool)
    if np.array_equal(steps, np.arange(1, steps.size + 1)):
        return ~visited
    places, following, place = [], steps.tolist(), 0
    while place < steps.size:
        places.append(place)
        place = following[place]
    visited[places] = True
    return visited


def note_on_rotor_order(firmware: str) -> tuple[Finding, ...]:
    """Return the finding that rotors are in the order of a firmware."""
    return (Finding("rotor_order_of_firmware", "", {"firmware": firmware}),)


def faster_first(channels: Sequence[LogChannel]) -> list[LogChannel]:
    """Return the channels, sorted so that one comes before another of its quantity if it is ``FASTER`` times as fast."""

    def key(channel: LogChannel) -> float:
        same = (one.time.size for one in channels if one.quantity == channel.quantity)
        return -float(np.floor(np.log(channel.time.size / next(same)) / np.log(FASTER)))

    return sorted(channels, key=key)
