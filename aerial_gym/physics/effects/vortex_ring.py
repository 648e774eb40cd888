"""Vortex ring state: a rotor that descends into its own wake loses thrust.

``dT = -k T (p(x) - 1) s(y)`` for a rotor of thrust T whose hub moves through the air with ``v_a = x v_h`` along the thrust and
``v_e = y v_h`` across it; ``v_h = sqrt(|T| / (2 rho pi R²))``. p(x) is the measured mean induced velocity of a descent, and the
loss follows its excess over hover: zero in hover and in climb, largest at x = -1.45 with p = 2.09, and zero again below
x = -2.0055, where p is back at 1 in the windmill brake state. ``s = (1 - y²)²`` below y = 1, else 0, because sideways flow
carries the ring away; the limit of one induced velocity is our choice, near measured boundaries.

k is the loss per excess, from measurements. With ``axial_inflow``, which adds the thrust of air from below, it is at most
``sigma a / (8 lambda_h)`` for solidity sigma, lift slope a and inflow lambda_h in hover; with a thrust map alone it is the net
of both. ``blade_element`` includes p(x) and needs no ``vortex_ring``. Fluctuations of the flow are neglected.
Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.13 (the fit); Shetty, Selig (2011),
Small-scale propellers operating in the vortex ring state, AIAA 2011-1254 (loss of thrust of small propellers); Johnson
(2005), Model for vortex ring state influence on rotorcraft flight dynamics, NASA/TP-2005-213477 (that sideways flow ends it).
"""

from math import pi

import torch
from torch import Tensor

from aerial_gym.math.rows import dot
from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.induced_flow import AIR_DENSITY, axial_induced
from aerial_gym.physics.effects.kinds.rotor import RotorEffect
from aerial_gym.physics.effects.parameter import Parameter

LEAST_SQUARE = 1e-6
"""Term added to the square of the induced velocity [m²/s²], which keeps the slope finite without thrust."""

LEAST = -8.0
"""Fastest descent in the formula, in induced velocities."""


class VortexRing(RotorEffect):
    """Loss of thrust in a fast descent."""

    name = "vortex_ring"
    summary = "loss of thrust in a fast descent into the own wake"
    parameters = (Parameter("k", "-", 0.0, 0.9, 0.1, "relative loss per relative excess of the inflow"),)
    excitation = (
        "steady descents at several rates up to twice the induced velocity of hover, with little sideways speed"
    )
    confused_with = ("axial_inflow", "quadratic_drag", "thrust_coefficient")
    rotors = ANY_ROTOR
    needs_radius = True
    follows = ("velocity",)
    by_default = False

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``-k T (p(x) - 1) s(y)``."""
        thrust, radius = condition.rotor_thrust, condition.vehicle.rotor_radius
        square = thrust.abs() / (2.0 * AIR_DENSITY * pi * radius.square()) + LEAST_SQUARE
        climb = torch.where(thrust < 0.0, -condition.axial_velocity, condition.axial_velocity) / square.sqrt()
        excess = (axial_induced(climb.clamp(LEAST, 0.0))[0] - 1.0).clamp_min(0.0)
        across = dot(condition.edgewise_velocity, condition.edgewise_velocity) / square
        return -params[:, :1] * thrust * excess * (1.0 - across).clamp_min(0.0).square()
