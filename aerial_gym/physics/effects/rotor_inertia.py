"""Rotor inertia: reaction torque of rotor acceleration on the body, and gyroscopic torque of spinning rotors.

With the momentum ``h = jr sum s w a`` of rotors of spin s, speed w and axis a, the body feels ``tau = -h' - w_body x h``.
Source: Derived: balance of angular momentum in a turning frame; e.g. Bouabdallah (2007), Design and control of quadrotors
with application to autonomous flying, section 2.3.
"""

import torch
from torch import Tensor

from aerial_gym.math.rows import sum_slices
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.wrench import LinearWrenchEffect
from aerial_gym.physics.effects.parameter import Parameter


class RotorInertia(LinearWrenchEffect):
    """Reaction and gyroscopic torque of the rotors."""

    name = "rotor_inertia"
    summary = "reaction to rotor acceleration, and gyroscopic torque"
    parameters = (Parameter("jr", "kg m²", 0.0, 0.01, 1e-6, "of one rotor about its axis"),)
    excitation = "quick yaw commands, or fast turns with unequal rotor speeds"
    at_hubs = True
    confused_with = ("torque_ratio", "inertia_error")
    rotors = ("reversible", "slew", "dead_band")

    def regressor(self, condition: Condition) -> Tensor:
        """Return (E, 6, 1)."""
        spin = condition.vehicle.rotor_spin[: condition.axis.shape[0]]  # shared if the axes are
        momentum, change = (
            sum_slices((spin * speed).unsqueeze(-1) * condition.axis, 1)
            for speed in (condition.rotor_speed, condition.rotor_acc)
        )
        torque = -change - torch.linalg.cross(condition.ang_vel, momentum)
        return torch.cat((torch.zeros_like(torque), torque), dim=1).unsqueeze(-1)
