"""How soft rotor arms bend along flights: driven by the thrust of the rotor speeds of each row.

Between rows the angle of rest runs in a straight line, along which an element is followed exactly. Logs do not tell the angles
at their start: arms rest there under the mean thrust of the first 0.5 s. A creep of some seconds whose log begins in the middle
of a change of thrust is off until that has faded.
Letters: T rows of a flight, P parameters, R rotors.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import lfilter
from torch import Tensor

from aerial_gym.physics import Vehicle
from aerial_gym.physics.effects.arm_joint import TAU, ArmJoint

Array = NDArray[np.float64]

SETTLED_S = 0.5
"""Arms rest at the start under the mean thrust of this span [s]."""


def follow_joint(rest: Array, *, tau: float, step: float) -> Array:
    """Return the angles [rad] of elements whose angles of rest [rad] are given every ``step`` [s], both (T, R).

    ``h_n+1 = a h_n + b0 r_n + b1 r_n+1`` with ``x = step / tau``, ``a = exp(-x)``, ``b1 = 1 - (1 - a) / x``,
    ``b0 = 1 - a - b1``: exact where r runs in straight lines between the rows.

    Source:
        Derived: ``tau h' = r - h`` with a linear r, integrated over a step.
    """
    share = step / tau
    decay, gained = np.exp(-share), -np.expm1(-share)
    later = 1.0 - gained / share
    start = rest[: max(1, round(SETTLED_S / step))].mean(axis=0)
    first = (start - later * rest[0])[None]  # of the filter, so that its output at row 0 is the start
    return lfilter([later, gained - later], [1.0, -decay], rest, axis=0, zi=first)[0]


def joint_angles(effect: ArmJoint, vehicle: Vehicle, params: Tensor, speed: Tensor, step: float) -> Tensor:
    """Return the angles of the arms [rad] in every row of a flight, (T, R).

    Args:
        effect: The element.
        vehicle: With the effects on its parameters applied, one environment.
        params: Of the element, (1, P).
        speed: True rotor speeds [rad/s], (T, R).
        step: Between two rows [s].
    """
    rest = effect.deflection(vehicle, speed, params).numpy()
    return torch.from_numpy(follow_joint(rest, tau=float(params[0, TAU]), step=step))
