"""Inputs of an effect's memory along a measured flight. Letters: T rows, R rotors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.math.decay import sum_with_decay
from aerial_gym.physics.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RotorSpeedsOfFlight:
    """Rows of one flight at equal time steps."""

    vehicle: Vehicle  # With the effects on its parameters applied, one environment
    rotor_speed: Tensor  # True rotor speeds [rad/s], (T, R)
    step: float  # Time between two rows [s]
    begins_on_ground: bool  # Whether the vehicle is on the ground in the first row
    settled: float = 1.0  # Initial memory of a flight that begins in the air, per steady value in hover


def relax(rest: Array, start: Array, *, tau: float, step: float) -> Array:
    """Return the response of first-order elements to steady states given every ``step`` [s], both (T, any).

    ``h_n+1 = a h_n + b0 r_n + b1 r_n+1`` with ``x = step / tau``, ``a = exp(-x)``, ``b1 = 1 - (1 - a) / x``,
    ``b0 = 1 - a - b1``: exact for r linear between the rows. ``start`` is h in the first row, (any,).

    Source:
        Derived: ``tau h' = r - h`` with a linear r, integrated over a step.
    """
    share = step / tau
    decay, gained = np.exp(-share), -np.expm1(-share)
    later = 1.0 - gained / share
    return sum_with_decay(np.concatenate((start[None], (gained - later) * rest[:-1] + later * rest[1:])), float(decay))
