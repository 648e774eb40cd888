"""Drag that grows linearly with speed: the induced drag of rotors and the blades' profile drag in sideways flow.

``F_i = -d_i v_i`` in body axes, at the centre of mass, with v the velocity through the air.
Source: Mahony, Kumar, Corke (2012), Multirotor Aerial Vehicles, section "induced drag"; Kai, Allibert, Hua, Hamel (2017),
Nonlinear feedback control of quadrotors exploiting first-order drag effects, eq. 4.
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.wrench import LinearWrenchEffect
from aerial_gym.physics.effects.parameter import Parameter


class RotorDrag(LinearWrenchEffect):
    """Linear drag per body axis."""

    name = "rotor_drag"
    summary = "force against the velocity through the air, linear in it, per body axis"
    parameters = tuple(Parameter(f"d{axis}", "N s/m", 0.0, 10.0, 0.1, f"drag along body {axis}") for axis in "xyz")
    excitation = "velocity along each body axis, in both directions or at several speeds"
    confused_with = ("quadratic_drag", "constant_wind", "com_offset")
    rotors = ANY_ROTOR
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-diag(v)`` for the force and zero for the torque, (E, 6, 3)."""
        force = -torch.diag_embed(condition.air_velocity)
        return torch.cat((force, torch.zeros_like(force)), dim=1)
