"""An effect: the weight of a cable that hangs from the centre of mass."""

import torch
from torch import Tensor

from aerial_gym.physics.effects import LinearWrenchEffect, Parameter
from aerial_gym.physics.effects.condition import Condition


class CableWeight(LinearWrenchEffect):
    """Weight of a cable that hangs from the centre of mass: ``F = -w up``, without inertia."""

    name = "cable_weight"
    summary = "weight of a hanging cable, without its inertia"
    parameters = (Parameter(name="w", unit="N", low=0.0, high=10.0, scale=0.1, meaning="weight of the cable"),)
    excitation = "thrust together with angular accelerations: in hover alone a payload looks the same"
    confused_with = ("payload_mass", "thrust_coefficient")

    def regressor(self, condition: Condition) -> Tensor:
        """Return the wrench of a cable of 1 N, (E, 6, 1)."""
        force = -condition.up  # world z in body axes
        return torch.cat((force, torch.zeros_like(force)), dim=-1).unsqueeze(-1)
