"""One flight as arrays: what a log holds, row by row.

World is ENU (z up), body is x forward, y left, z up, quaternions are xyzw, body to world, SI units.
Letters: T rows, R rotors.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding

AT_REST = np.array((0.0, 0.0, STANDARD_GRAVITY))
"""What an accelerometer at rest reads, along world axes [m/s²], (3,)."""

LONGEST_GAP_ROWS = 5
"""A gap of more rows than this, and of more than LONGEST_GAP_S, ends a flight."""

LONGEST_GAP_S = 0.1
"""[s]."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a log and the flight that is made of it have in common; None: it was not measured. World ENU, body FLU, SI."""

    path: str
    """File, as error messages and reports call it."""

    time: Array
    """[s], increasing, (T,)."""

    attitude: Array
    """Body to world, xyzw, (T, 4)."""

    position: Array | None = None
    """Body origin [m], world, (T, 3)."""

    lin_vel: Array | None = None
    """Of the body origin [m/s], world, (T, 3)."""

    specific_force: Array | None = None
    """At the body origin [m/s²], body: +9.81 on z at hover, (T, 3)."""

    rotor_speed: Array | None = None
    """Measured [rad/s], (T, R); rotors in force mode have none."""

    rotor_command: Array | None = None
    """Speeds commanded from each row on [rad/s], in force mode thrusts [N], (T, R)."""

    battery: Array | None = None
    """Voltage [V], (T,)."""

    attitude_integrated: bool = False
    """Whether the attitude is that which the gyro implies, and so no check of the gyro."""

    other_position: Array | None = None
    """Body origin of another vehicle flown at the same time [m], world, (T, 3); NaN where it is not known."""

    ground_height: float = 0.0
    """World z of the ground [m]."""

    ceiling_height: float | None = None
    """World z of the ceiling [m]; None if the log does not say."""

    wind: tuple[float, float, float] | None = None
    """Steady wind that was known to whoever flew [m/s], world; None: still air as far as is known."""

    notes: tuple[Finding, ...] = ()
    """What was done to the log, for the report; no subject: it is the log."""


@dataclass(frozen=True, kw_only=True)
class FlightLog(Recording):
    """What was measured in one flight, row by row of its file; quaternions are not yet made unit."""

    ang_vel: Array | None = None
    """[rad/s], body, (T, 3)."""

    collective: bool = False
    """Whether all rotors share one command: it says nothing about torques."""

    lift_off: float = 0.0
    """Within this of a height at which it stood the vehicle stands on the ground [m]; 0: heights tell nothing."""

    hover_above: float | None = None
    """Commanded speeds are to be scaled to the thrust measured above this height [m], world; None: they are not."""

    torques: bool = True
    """Whether the log shows what torques do."""

    lines: Indices | None = None
    """Line of each row in its file, (T,); None for binary logs and for rows that were resampled."""

    @property
    def name(self) -> str:
        """File name without folder and ending."""
        return Path(self.path).stem

    @property
    def num_rotors(self) -> int:
        """Number of rotors R in the log."""
        rotors = self.rotor_speed if self.rotor_speed is not None else self.rotor_command
        return 0 if rotors is None else rotors.shape[1]

    def where(self, row: int) -> str:
        """Return the name of a row for messages: file, line if it has one, and time."""
        line = "" if self.lines is None else f", line {self.lines[row]}"
        return f"{self.path}{line} (t = {self.time[row]:.6g} s)"


HIGHEST_BAND = 0.2
"""Measured and predicted are compared at most to this share of the slowest log's rate."""

NORM_OFF = 0.05
"""A quaternion whose norm is off 1 by more is none."""

Some = TypeVar("Some", bound=Recording)


def part_of(log: Some, rows: slice | Flags) -> Some:
    """Return some rows of a log, or of a flight."""
    return replace(log, **{name: values[rows] for name, values in arrays_of(log).items()})


def arrays_of(log: Recording) -> dict[str, Array]:
    """Return what has a value in every row, by name, (T, any)."""
    return {f.name: value for f in fields(log) if isinstance(value := getattr(log, f.name), np.ndarray)}


def gap_limit(step: float) -> float:
    """Return the longest gap in time [s] that can be bridged, for a usual step [s]."""
    return max(LONGEST_GAP_ROWS * step, LONGEST_GAP_S)


def rate_of(log: FlightLog) -> float:
    """Return the rows per second [Hz]."""
    return (log.time.size - 1) / float(log.time[-1] - log.time[0])
