"""Failures in flight: one rotor from some time on, or all rotors for a while, deviate from their commands.

A failure belongs to one flight. Letters: F flights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.undeclared.vehicle import Array

KINDS = ("motor_failure", "weak_motor", "stuck_rotor", "brown_out")
"""A motor that reaches a share of its command; a propeller that has lost a share of its blades; a rotor that keeps its
speed; all motors at a share of their commands for a while."""


@dataclass(frozen=True, kw_only=True)
class PlantFailure:
    """Failure of one flight, with its time."""

    kind: str  # One of ``KINDS``
    time: float  # From the first row of the log on [s]
    motor: int = 1  # Which rotor, from 1 on; nothing to a brown-out

    scale: float = 1.0
    """Speed per commanded speed, of ``weak_motor`` thrust and drag torque per what they were; nothing to a stuck rotor."""

    duration: float = np.inf  # How long it lasts [s]

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"Failure.kind = {self.kind!r}. Known: {', '.join(KINDS)}")
        if self.motor not in (1, 2, 3, 4):
            raise ValueError(f"Failure.motor = {self.motor!r}: must be 1, 2, 3 or 4")
        if not (self.time >= 0.0 and self.duration > 0.0 and 0.0 <= self.scale < np.inf):
            raise ValueError(f"{self}: needs time >= 0, duration > 0 and a finite scale >= 0")

    def document(self) -> dict[str, object]:
        """Return the failure as plain data, without the fields that do not apply to its kind."""
        result: dict[str, object] = {"kind": self.kind, "time": self.time}
        if self.kind != "brown_out":
            result["motor"] = self.motor
        if self.kind != "stuck_rotor":
            result["scale"] = self.scale
        return result if self.duration == np.inf else {**result, "duration": self.duration}


class Failures:
    """Effects of the failures of F flights at an instant; ``start`` is the time of the first row of the logs [s]."""

    def __init__(self, failures: Sequence[PlantFailure | None], start: float) -> None:
        self._failures, self._start = tuple(failures), start
        self._kept = np.full((len(self._failures), 4), np.nan)

    def begin_step(self, time: float, rotor: Array) -> None:
        """Take note of the speeds (F, 4) [rad/s] at which rotors stick from the step at ``time`` [s] on."""
        for row, failure in self._active_failures(time, "stuck_rotor"):
            place = row, failure.motor - 1
            if np.isnan(self._kept[place]):
                self._kept[place] = rotor[place]

    def document(self, row: int) -> dict[str, object]:
        """Return the failure of a flight as plain data, with the speed of a stuck rotor [rad/s]."""
        failure = self._failures[row]
        assert failure is not None
        kept = self._kept[row, failure.motor - 1]
        return failure.document() | ({} if np.isnan(kept) else {"speed": float(kept)})

    def rotor_targets(self, target: Array, time: float) -> Array:
        """Return the target speeds of the rotors under failures [rad/s], from those without, both (F, 4)."""
        led = np.where(np.isnan(self._kept), target, self._kept)
        for row, failure in self._active_failures(time, "motor_failure"):
            led[row, failure.motor - 1] *= failure.scale
        for row, failure in self._active_failures(time, "brown_out"):
            led[row] *= failure.scale
        return led

    def blade_squares(self, squared: Array, time: float) -> Array:
        """Return squared speeds [rad²/s²] times the remaining share of the blades' thrust, (F, 4)."""
        left = squared.copy()
        for row, failure in self._active_failures(time, "weak_motor"):
            left[row, failure.motor - 1] *= failure.scale
        return left

    def _active_failures(self, time: float, kind: str) -> list[tuple[int, PlantFailure]]:
        since = time - self._start
        return [
            (row, failure)
            for row, failure in enumerate(self._failures)
            if failure is not None
            and failure.kind == kind
            and -1e-9 <= since - failure.time < failure.duration - 1e-9  # a step begins at a multiple of 0.5 ms
        ]
