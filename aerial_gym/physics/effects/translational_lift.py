"""Translational lift: thrust grows in sideways flow, because a rotor then meets undisturbed air.

``dT = kt |v_e|²`` for a rotor whose hub moves at v_e in its own plane through the air.
Source: Svacha, Mohta, Kumar (2017), Improving quadrotor trajectory tracking by compensating for aerodynamic effects, eq. 6;
Leishman (2006), Principles of Helicopter Aerodynamics, section 2.14.2 (Glauert's formula, expanded at low speed).
"""

from torch import Tensor

from aerial_gym.math.rows import dot
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.rotor import RotorEffect
from aerial_gym.physics.effects.parameter import Parameter


class TranslationalLift(RotorEffect):
    """Thrust with the square of the sideways velocity."""

    name = "translational_lift"
    summary = "thrust that grows with the square of the velocity in the rotor plane"
    parameters = (Parameter("kt", "N s²/m²", 0.0, 1.0, 0.005, "thrust per velocity squared"),)
    excitation = "several different sideways speeds, some of them high"
    confused_with = ("thrust_coefficient", "quadratic_drag", "payload_mass")
    rotors = ("force", "slew", "dead_band")
    follows = ("velocity",)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``kt |v_e|²``."""
        return params[:, :1] * dot(condition.edgewise_velocity, condition.edgewise_velocity)
