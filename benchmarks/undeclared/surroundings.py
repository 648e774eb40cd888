"""Surroundings of the vehicle (gusts, a ceiling, another vehicle), the battery, and the failures of each flight.

Letters: F flights, T samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.undeclared.trajectories import Reference
from benchmarks.undeclared.vehicle import Array, PlantVehicle

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


CEILING_HEIGHT = 14.0  # Height of the ceiling, where there is one [m]
NOMINAL_VOLTAGE = 16.0  # Voltage at which a commanded rotor speed is reached exactly, whatever `battery_gain` [V]
VOLTAGE_NOISE = 0.02  # Standard deviation of one sample of the logged voltage, where it moves [V]

FULL_VOLTAGE, VOLTAGE_PER_CHARGE, RESISTANCE, EFFICIENCY = 16.7, 2.0 / 3700.0, 0.03, 0.6
"""Open circuit of 4 full lithium-polymer cells [V]; fall per charge, 2 V over 80 % of 1.3 Ah [V/C]; of pack and leads
[ohm]; shaft power per electric power of motor and driver [-]. Invented, typical of the size of the vehicle."""


@dataclass(frozen=True, kw_only=True)
class PlantSurroundings:
    """Series over the samples of all flights; None: not there."""

    gust: Array | None = None  # Velocity of the air beside the steady wind [m/s], world, (T, F, 3)
    other: Array | None = None  # Position of the other vehicle [m], world, (T, F, 3)
    ceiling: float | None = None  # Height [m]
    rate: float = 400.0  # Samples per second [Hz]
    failures: Failures | None = None  # What fails in flight


def gust_series(std: float, corr_time: float, count: int, rate: float, rng: np.random.Generator) -> Array:
    """Return a stationary Ornstein-Uhlenbeck series of each axis [m/s], (T, 3): correlation ``exp(-t / corr_time)``.

    Exact at the samples: ``w' = a w + std sqrt(1 - a²) e`` with ``a = exp(-1 / (rate corr_time))``.

    Source: C. Gardiner, *Handbook of Stochastic Methods*, ch. 3.8.4; the longitudinal Dryden spectrum (MIL-F-8785C)
    seen at a constant airspeed.
    """
    keep = np.exp(-1.0 / (rate * corr_time))
    draws = std * rng.standard_normal((count, 3))
    draws[1:] *= np.sqrt(1.0 - keep * keep)
    return np.asarray(lfilter([1.0], [1.0, -keep], draws, axis=0))


def companion_path(reference: Reference, flight: int, rate: float, rng: np.random.Generator) -> Array:
    """Return the path of another vehicle above a flight [m], world, (T, 3).

    On even flights it keeps above the reference and strays up to half a metre from it on each axis; on odd ones it hovers
    half a metre from the start, so that the flight passes below. 1.2 to 2 m above the highest point of the reference.
    """
    path = reference.position[:, flight]
    count = len(path)
    top = path[:, 2].max() + rng.uniform(1.2, 2.0)
    angle, t = rng.uniform(0.0, 2.0 * np.pi, 4), np.arange(count) / rate
    if flight % 2:
        level = path[0, :2] + 0.5 * np.array([np.cos(angle[0]), np.sin(angle[0])])
        level = np.repeat(level[None], count, axis=0)
    else:
        stray = 0.5 * np.stack((np.sin(0.9 * t + angle[1]), np.sin(1.3 * t + angle[2])), axis=1)
        level = path[:, :2] + stray
    height = top + 0.2 * np.sin(0.5 * t + angle[3])
    return np.concatenate((level, height[:, None]), axis=1)


class Battery:
    """Terminal voltage of F flights: open circuit that falls with the charge drawn, less current times resistance.

    Source: O. Tremblay, L.-A. Dessaint, A.-I. Dekkiche, "A generic battery model for the dynamic simulation of hybrid
    electric vehicles", VPPC 2007, on the linear part of the discharge.
    """

    def __init__(self, vehicle: PlantVehicle, used: Array) -> None:
        """Start with a charge already used [C], (F,)."""
        self._open = FULL_VOLTAGE - VOLTAGE_PER_CHARGE * used
        self._power = vehicle.torque_ratio * vehicle.thrust_coeff / EFFICIENCY

    def discharge(self, rotor: Array, dt: float) -> Array:
        """Return the voltage [V], (F,), at rotor speeds (F, 4), and take the charge of ``dt`` [s].

        The power P is that of the drag torque, ``V = V0 - R I`` and ``P = V I``: ``V = (V0 + sqrt(V0² - 4 R P)) / 2``.
        """
        power = rotor**3 @ self._power
        voltage = 0.5 * (self._open + np.sqrt(np.maximum(self._open**2 - 4.0 * RESISTANCE * power, 0.0)))
        self._open = self._open - VOLTAGE_PER_CHARGE * dt * power / voltage
        return voltage
