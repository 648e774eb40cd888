"""Downwash: the wake of a vehicle above pushes this one down.

``F = -force exp(-d² / 2 sigma²)`` along world z at the centre of mass, with the horizontal distance d to the other vehicle, and
0 above it. In the simulator the other vehicle is at ``downwash_position`` (GTD), by default infinitely high over the
environment's origin.
Source: Gaussian profile of a developed jet: Pope (2000), Turbulent Flows, section 5.1; such forces between multirotors are
measured by Shi, Honig, Shi, Yue, Chung (2022), Neural-Swarm2, IEEE T-RO. The decay of the jet with height is left out.
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.wrench import WrenchEffect
from aerial_gym.physics.effects.parameter import Parameter


class Downwash(WrenchEffect):
    """Downward force in the wake of another vehicle."""

    name = "downwash"
    summary = "downward force in the wake of a vehicle above"
    parameters = (
        Parameter("force", "N", 0.0, 100.0, 0.5, "right below the other vehicle"),
        Parameter("sigma", "m", 0.01, 10.0, 0.2, "horizontal width", neutral=0.3),
    )
    excitation = "passes below another vehicle whose position is in the log"
    confused_with = ("gusts", "thrust_coefficient", "ground_effect")
    rotors = ANY_ROTOR
    follows = ("position",)
    needs = ("position", "other_position")

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque (E, 6)."""
        away = (condition.position - condition.other_position)[:, :2]
        share = torch.exp(-0.5 * away.square().sum(-1) / params[:, 1].square())
        below = condition.position[:, 2] < condition.other_position[:, 2]
        force = -(params[:, 0] * torch.where(below, share, 0.0)).unsqueeze(-1) * condition.up
        return torch.cat((force, torch.zeros_like(force)), dim=-1)
