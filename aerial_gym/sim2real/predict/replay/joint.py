"""How soft rotor arms bend along flights: driven by the thrust of the rotor speeds of each row.

Between rows the angle of rest runs in a straight line, along which an element is followed exactly. Logs do not tell what arms
bore before: they are taken to rest at the start as in hover, shared among the rotors as over the flight, or under the thrust
of the first row if the vehicle then stands. How far they are from that is one of the tolerances, the same in all flights: a
creep that has only begun when logs begin.
Letters: T rows of a flight, P parameters, R rotors.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import lfilter
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.physics import Vehicle
from aerial_gym.physics.effects.arm_joint import TAU, ArmJoint
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.sim2real.logs.flights import Flight

Array = NDArray[np.float64]


def follow_joint(rest: Array, start: Array, *, tau: float, step: float) -> Array:
    """Return the angles [rad] of elements whose angles of rest [rad] are given every ``step`` [s], both (T, R).

    ``h_n+1 = a h_n + b0 r_n + b1 r_n+1`` with ``x = step / tau``, ``a = exp(-x)``, ``b1 = 1 - (1 - a) / x``,
    ``b0 = 1 - a - b1``: exact where r runs in straight lines between the rows. ``start`` is h in the first row, (R,).

    Source:
        Derived: ``tau h' = r - h`` with a linear r, integrated over a step.
    """
    share = step / tau
    decay, gained = np.exp(-share), -np.expm1(-share)
    later = 1.0 - gained / share
    past = start - later * rest[0]  # so that the output in the first row is the start
    return lfilter([later, gained - later], [1.0, -decay], rest, axis=0, zi=past[None])[0]


def joint_angles(
    effect: ArmJoint,
    vehicle: Vehicle,
    params: Tensor,
    flight: Flight,
    speed: Tensor,
    step: float,
    *,
    share: float = 1.0,
) -> Tensor:
    """Return the angles of the arms [rad] in every row of a flight, (T, R).

    Args:
        effect: The element.
        vehicle: With the effects on its parameters applied, one environment.
        params: Of the element, (1, P).
        flight: Tells whether the vehicle stands at the start.
        speed: True rotor speeds [rad/s], (T, R), in all rows of the log or in every n-th one.
        step: Between two of these rows [s].
        share: Of the angle of rest in hover that arms have at the start of a flight that does not stand then.
    """
    rest = effect.deflection(vehicle, speed, params).numpy()
    if flight.on_ground is not None and flight.on_ground[0]:
        start = rest[0]
    else:
        lift = (rotor_thrust(vehicle, speed) * vehicle.rotor_axis[..., 2]).sum(dim=1).mean()
        start = share * float(vehicle.mass[0] * STANDARD_GRAVITY / lift) * rest.mean(axis=0)
    return torch.from_numpy(follow_joint(rest, start, tau=float(params[0, TAU]), step=step))
