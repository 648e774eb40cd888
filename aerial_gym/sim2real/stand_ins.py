"""Explanations that are no registered effect: a declared number, or a sensor, that is off by more than its tolerance.

They keep an effect from being named for what, say, one weak motor or a biased accelerometer explains as well or better.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS

STAND_INS: dict[str, str] = {
    "payload_mass": "mass",
    "weak_motor": "thrust_",
    "inertia_error": "inertia_",
    "imu_bias": "acc_bias_",
}
"""Name of the explanation to the start of the names of the tolerances that it sets free."""

SENSOR_STAND_INS = ("imu_bias",)
"""Errors of a sensor: where one explains the flights as well as an effect of the vehicle, the effect is not named."""


def stand_ins(tolerances: Sequence[str]) -> dict[str, NDArray[np.int64]]:
    """Return the places of the tolerances that each explanation sets free; those that are registered effects are left out."""
    return {
        name: np.array([place for place, tolerance in enumerate(tolerances) if tolerance.startswith(start)], dtype=int)
        for name, start in STAND_INS.items()
        if name not in EFFECTS
    }
