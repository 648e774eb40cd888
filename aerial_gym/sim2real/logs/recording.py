"""Arrays of one recorded flight, row by row.

World is ENU (z up), body is x forward, y left, z up, quaternions are xyzw, body to world, SI units.
Letters: T rows, R rotors.
"""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding

AT_REST = np.array((0.0, 0.0, STANDARD_GRAVITY))  # Reading of an accelerometer at rest in world axes [m/s²], (3,)
LONGEST_GAP_ROWS = 5  # A gap of more rows than this and of more than LONGEST_GAP_S ends a flight
LONGEST_GAP_S = 0.1  # [s]
LATE_S = 0.003  # Standard deviation of each sensor's unknown delay [s]: milliseconds of filters and telemetry
GAP_STEPS = 2.5  # A longer step, in usual steps, is a gap and does not count for the rate


@dataclass(frozen=True, kw_only=True)
class StreamTiming:
    """Rate and delay of one quantity in its log, before it was brought onto the rows."""

    source: str  # Topic and instance
    rate: float  # Samples per second [Hz]
    latency: float | None = None  # Delay from sampling to recording [s], if the format states both
    delay: float | None = None  # Measured delay behind the inertial sensors [s]; None if the motion does not show it
    half_width: float | None = None  # Half width of its 95 % interval [s]
    with_lag: bool = False  # Whether the delay is that of commands less the rotor lag: no flight tells both apart


@dataclass(frozen=True, kw_only=True)
class PairMember:
    """Place of a log among the logs of two vehicles in one flight."""

    pair: int  # Number of the flight of two vehicles
    vehicle: int  # 0 for the first vehicle of the pair, 1 for the second one
    clock: float  # Added to the times of the log, gives the common clock [s]


METRES_PER_DEG = 111_319.5  # Length of a degree of the equator. Source: WGS 84, 6378137 m pi / 180


class FrameOrigin(NamedTuple):
    """Geodetic coordinates of the origin of an estimator's local frame; NaN where the log does not state them."""

    latitude: float = nan  # [deg]
    longitude: float = nan  # [deg]
    altitude: float = nan  # [m]

    @property
    def is_known(self) -> bool:
        """Whether the log states all coordinates."""
        return all(isfinite(value) for value in self)

    def local_position(self, latitude: Array, longitude: Array, altitude: Array) -> Array:
        """Return places in this frame [m], east, north and up, (T, 3), near the origin."""
        east = METRES_PER_DEG * np.cos(np.radians(self.latitude)) * (longitude - self.longitude)
        return np.stack((east, METRES_PER_DEG * (latitude - self.latitude), altitude - self.altitude), axis=-1)


@dataclass(frozen=True, kw_only=True)
class LogIdentity:
    """Vehicle, firmware and start of a log, as far as the log states them."""

    airframe: str = ""  # Serial number of the autopilot, or the name that its owner gave the vehicle
    firmware: str = ""  # Name and version
    start_time: float | None = None  # Unix time of the first row [s]


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Common data of a log and its flight, in world ENU, body FLU and SI units; None: not measured."""

    path: str  # File name for messages and reports
    time: Array  # [s], increasing, (T,)
    attitude: Array  # Body to world, xyzw, (T, 4)
    position: Array | None = None  # Body origin [m], world, (T, 3)
    lin_vel: Array | None = None  # Velocity of the body origin [m/s], world, (T, 3)
    specific_force: Array | None = None  # Specific force at the body origin [m/s²], body, (T, 3): +9.81 on z at hover
    rotor_speed: Array | None = None  # Measured [rad/s], (T, R); None for rotors in force mode
    rotor_command: Array | None = None  # Commanded speeds from each row on [rad/s], in force mode thrusts [N], (T, R)
    battery: Array | None = None  # Voltage [V], (T,)
    lost: Flags | None = None  # Rows within a gap of the log, interpolated and not compared, (T,); None without gaps
    attitude_integrated: bool = False  # Whether the attitude is the integrated gyro, and so no independent measurement
    other_position: Array | None = None  # Body origin of another vehicle [m], world, (T, 3); NaN where unknown
    origin: FrameOrigin | None = None  # Of the world frame, if it is local to the estimator; None: the user's frame
    pair: PairMember | None = None  # None: not given as the log of one of two vehicles
    ground_height: float = 0.0  # World z of the ground [m]
    ceiling_height: float | None = None  # World z of the ceiling [m]; None if unknown
    wind: tuple[float, float, float] | None = None  # Known steady wind [m/s], world; None: still air is assumed
    streams: Mapping[str, StreamTiming] = field(default_factory=dict)  # By field name; empty if all have the rows' rate
    setpoints: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    """Times on the clock of ``time`` [s] and values of each logged setpoint, a key of ``raw_log.SETPOINTS``."""

    parameters: Mapping[str, float | str] = field(default_factory=dict)  # Of the firmware, by name
    log_format: str = "csv"
    identity: LogIdentity = field(default_factory=LogIdentity)
    command_curve: tuple[float, float, float] | None = None
    """Numbers a, b, n of the scale ``w = a + b u^n`` from shares u to ``rotor_command``; None for other commands."""

    notes: tuple[Finding, ...] = ()  # Repairs and defects of the log, without subject

    @property
    def rows_without_other(self) -> Flags | None:
        """Rows in which the other vehicle of a pair is unknown, (T,); None if there are none."""
        if self.pair is None or self.other_position is None:
            return None
        unknown = np.isnan(self.other_position).any(axis=1)
        return unknown if unknown.any() else None

    @property
    def rotor_states(self) -> Array | None:
        """Measured states of the rotors, or else their commands, (T, R)."""
        return self.rotor_command if self.rotor_speed is None else self.rotor_speed

    @property
    def num_rotors(self) -> int:
        """Number of rotors R; 0 if neither states nor commands are logged."""
        return 0 if self.rotor_states is None else self.rotor_states.shape[1]


def flight_numbers(logs: Sequence[Recording]) -> Indices:
    """Return the number of the flight of each log, from 0: the logs of two vehicles in one flight are not independent."""
    numbers = dict[int, int]()
    keys = [-1 - index if log.pair is None else log.pair.pair for index, log in enumerate(logs)]
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys])


@dataclass(frozen=True, kw_only=True)
class FlightLog(Recording):
    """Measurements of one flight, row by row of its file; quaternions are not normalised."""

    ang_vel: Array | None = None  # [rad/s], body, (T, 3)
    collective: bool = False  # Whether all rotors share one command, which determines no torque
    lift_off: float = 0.0  # Height tolerance for rows on the ground [m]; 0: heights are ignored
    hover_above: float | None = None  # World height [m] above which commands are scaled to the thrust; None: no scaling
    torques: bool = True  # Whether the log resolves torques
    relative_commands: bool = False  # Whether commands are shares of the largest speed, 0 to 1, as firmwares log them
    sample_times: Mapping[str, Array] = field(default_factory=dict)  # Of streams slower than the rows, by field [s]
    lines: Indices | None = None  # Line of each row in its file, (T,); None for binary logs and resampled rows

    @property
    def name(self) -> str:
        """File name without folder and suffix, with the number of the flight."""
        file, number = split_flight_number(self.path)
        return Path(file).stem + ("" if number is None else f"#{number}")

    def __repr__(self) -> str:
        known = [name for name in row_arrays(self) if name not in ("time", "lines", "lost")]
        rows, span = len(self.time), float(self.time[-1] - self.time[0]) if len(self.time) else 0.0
        rate = f" at {(rows - 1) / span:.4g} Hz" if span else ""
        kind = f"{self.log_format}, {self.num_rotors} rotors"
        return f"FlightLog {self.name}: {rows:,} rows in {span:.1f} s{rate}; {kind}; {', '.join(known)}"

    def row_name(self, row: int) -> str:
        """Return a row's name for messages: file, line if known, and time."""
        line = "" if self.lines is None else f", line {self.lines[row]}"
        return f"{self.path}{line} (t = {self.time[row]:.6g} s)"


HIGHEST_BAND = 0.2  # Largest comparison bandwidth as a share of the slowest compared stream's rate
NORM_OFF = 0.05  # Largest deviation of a quaternion's norm from 1

Some = TypeVar("Some", bound=Recording)


def absent_pairs(known: Collection[str], *, hover: bool, partial: bool) -> list[tuple[str, str]]:
    """Return the pairs of quantities of which a flight needs one and has none.

    The attitude with position or velocity shows the motion without inertial sensors; ``hover`` needs none of them.
    ``partial``: a flight needs nothing, as in a plot.
    """
    moves = hover or ("attitude" in known and not {"position", "lin_vel"}.isdisjoint(known))
    needed = (
        [("rotor_speed", "rotor_command")]
        if moves
        else [("ang_vel", "specific_force"), ("rotor_speed", "rotor_command")]
    )
    return [] if partial else [pair for pair in needed if not set(pair) & set(known)]


def split_flight_number(path: str | Path) -> tuple[str, int | None]:
    """Return file and flight number of ``FILE#2``; the number is None without one, or if a file has this very name."""
    file, mark, number = str(path).rpartition("#")
    return (file, int(number)) if mark and number.isdecimal() and not os.path.lexists(path) else (str(path), None)


def comparable_rate(log: Recording, rate: float) -> float:
    """Return the lowest rate [Hz] of the compared streams: force and rotors; ``rate`` is that of the rows.

    A force without accelerometer is derived from velocity and attitude, and has their rates.
    """
    rotors = "rotor_speed" if log.rotor_speed is not None else "rotor_command"
    measured = getattr(log, "accelerometer", log.specific_force is not None)
    names = (rotors, *(("specific_force",) if measured else ("lin_vel", "attitude")))
    return min([rate, *(log.streams[name].rate for name in names if name in log.streams)])


def take_rows(log: Some, rows: slice | Flags) -> Some:
    """Return the selected rows of a log or flight."""
    return replace(log, **{name: values[rows] for name, values in row_arrays(log).items()})


def row_arrays(log: Recording) -> dict[str, Array]:
    """Return the arrays with one entry per row, by field name, (T, any)."""
    return {f.name: value for f in fields(log) if isinstance(value := getattr(log, f.name), np.ndarray)}


def longest_bridgeable_gap(step: float) -> float:
    """Return the longest bridgeable time gap [s] for a usual step [s]."""
    return max(LONGEST_GAP_ROWS * step, LONGEST_GAP_S)


def position_at_times(log: Recording, time: Array) -> Array:
    """Return the position at other times on the clock of the log [m], (T, 3); NaN within gaps and outside the log."""
    assert log.position is not None
    place = np.stack([np.interp(time, log.time, one, left=np.nan, right=np.nan) for one in log.position.T], axis=1)
    after = np.clip(np.searchsorted(log.time, time), 1, log.time.size - 1)
    steps = np.diff(log.time)
    place[steps[after - 1] > longest_bridgeable_gap(float(np.median(steps)))] = np.nan
    return place


def interpolate_setpoint(log: Recording, name: str) -> tuple[Array, Flags]:
    """Return a logged setpoint in all rows, linear between its samples, and the rows between close samples."""
    time, values = log.setpoints[name]
    values = np.unwrap(values, axis=0) if name == "yaw_setpoint" else values
    rows = np.stack([np.interp(log.time, time, column) for column in values.T], axis=1)
    if time.size < 2:
        return rows, np.zeros(log.time.size, dtype=bool)
    place = np.clip(np.searchsorted(time, log.time, side="right"), 1, time.size - 1)
    close = time[place] - time[place - 1] <= longest_bridgeable_gap(float(np.median(np.diff(time))))
    edge = 0.5 * float(np.median(np.diff(log.time)))
    return rows, close & (log.time >= time[0] - edge) & (log.time <= time[-1] + edge)


def sample_rate(log: Recording) -> float:
    """Return the sample rate [Hz]."""
    return (log.time.size - 1) / float(log.time[-1] - log.time[0])
