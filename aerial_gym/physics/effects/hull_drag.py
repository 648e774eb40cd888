"""Damping of a hull in water: linear and quadratic, along and about each body axis.

``F_i = -(l_i + q_i |v_i|) v_i`` and ``tau_i = -(a_i + b_i |w_i|) w_i`` at the centre of mass, v through the water. Each axis is
by itself, as tank tests give it; ``quadratic_drag`` is the law for a body in air, with the speed in place of ``|v_i|``.
Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, section 8.1 (uncoupled motions).
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.wrench import LinearWrenchEffect
from aerial_gym.physics.effects.parameter import Parameter

_MEANING = {
    "l": ("N s/m", 1.0, "force per speed along body"),
    "q": ("N s²/m²", 1.0, "force per speed squared along body"),
    "a": ("N m s/rad", 0.01, "torque per rate about body"),
    "b": ("N m s²/rad²", 0.01, "torque per rate squared about body"),
}


class HullDrag(LinearWrenchEffect):
    """Twelve coefficients of damping."""

    name = "hull_drag"
    summary = "damping of a hull in water: linear and quadratic, along and about each body axis"
    parameters = tuple(
        Parameter(f"{letter}{axis}", unit, 0.0, 1e4, scale, f"{meaning} {axis}")
        for letter, (unit, scale, meaning) in _MEANING.items()
        for axis in "xyz"
    )
    excitation = "several speeds through the water and rates along and about each body axis"
    confused_with = ("rotor_drag", "quadratic_drag", "constant_wind")
    rotors = ANY_ROTOR
    medium = "water"
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-diag(v), -diag(|v| v), -diag(w), -diag(|w| w)`` in their places, (E, 6, 12)."""
        v, w = condition.air_velocity, condition.ang_vel
        along, about = (torch.cat([torch.diag_embed(u), torch.diag_embed(u.abs() * u)], dim=-1) for u in (v, w))
        none = torch.zeros_like(along)
        return -torch.cat((torch.cat((along, none), dim=-1), torch.cat((none, about), dim=-1)), dim=1)
