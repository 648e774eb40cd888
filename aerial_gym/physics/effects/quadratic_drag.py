"""Drag of the body in the airstream, growing with the square of the speed.

``F_i = -d_i |v| v_i`` in body axes, at the centre of mass, with v the velocity through the air; for equal d_i this is the
textbook ``0.5 rho C_D A |v|²`` against the motion.
Source: Hoerner (1965), Fluid-Dynamic Drag, chapter 1, with one area per body axis.
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.wrench import LinearWrenchEffect
from aerial_gym.physics.effects.parameter import Parameter


class QuadraticDrag(LinearWrenchEffect):
    """Quadratic drag per body axis."""

    name = "quadratic_drag"
    summary = "force against the velocity through the air, quadratic in speed, per body axis"
    parameters = tuple(Parameter(f"d{axis}", "N s²/m²", 0.0, 10.0, 0.05, f"drag along body {axis}") for axis in "xyz")
    excitation = "several different speeds through the air, some of them high, along each body axis"
    confused_with = ("rotor_drag", "constant_wind")
    rotors = ANY_ROTOR
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-|v| diag(v)`` for the force and zero for the torque, (E, 6, 3)."""
        v = condition.air_velocity
        square = (v * v).sum(-1, keepdim=True)
        moving = square > 0.0
        speed = torch.where(moving, square, torch.ones_like(square)).sqrt() * moving  # gradient finite at rest
        force = -torch.diag_embed(speed * v)
        return torch.cat((force, torch.zeros_like(force)), dim=1)
