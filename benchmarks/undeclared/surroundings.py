"""Surroundings of the vehicle (gusts, a ceiling, another vehicle), the battery, and the failures of each flight.

Letters: F flights, T samples.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.undeclared.failures import Failures
from benchmarks.undeclared.trajectories import Reference
from benchmarks.undeclared.vehicle import Array, PlantVehicle

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
    series = np.empty((count, 3))
    series[0] = draws[0]
    for i in range(1, count):
        series[i] = keep * series[i - 1] + np.sqrt(1.0 - keep * keep) * draws[i]
    return series


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
