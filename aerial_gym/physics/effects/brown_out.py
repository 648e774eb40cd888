"""Brown-out: a temporary loss of supply voltage, during which all motors reach a part of their commands, or none.

It starts at the substep boundary nearest to ``time`` after the reset and lasts for ``duration``. All rotors then approach
``scale`` times the command, each with its own lag, and afterwards the command again. Causes are a loose contact, a failing
battery, or a restart of speed controllers. ``battery_sag`` models charge and load of an intact battery.
Source: motor speed proportional to voltage, as in ``battery_sag``: Drela (2007), First-order DC electric motor model.
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, SubstepStart
from aerial_gym.physics.effects.failure import LATEST, TIME, substep_middle
from aerial_gym.physics.effects.kinds.command import CommandEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class BrownOut(CommandEffect):
    """A temporary factor on the commands of all rotors."""

    name = "brown_out"
    summary = "for a while all rotors reach a part of their commands, or nothing"
    parameters = (
        Parameter("scale", "-", 0.0, 2.0, 0.3, "speed, in force mode thrust, per command, while it lasts", neutral=1.0),
        TIME,
        Parameter("duration", "s", 0.0, LATEST, 0.1, "until the supply recovers", kind="convention"),
    )
    excitation = "an episode that goes on after it; a log does not say when its reset was"
    confused_with = ("battery_sag", "thrust_coefficient")
    rotors = ANY_ROTOR
    memory = (1.0,)  # Factor on the commands
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the factor of this substep, (E, 1)."""
        since = substep_middle(moment, values).unsqueeze(-1) - values[:, 1:2]
        return torch.where((since >= 0.0) & (since < values[:, 2:3]), values[:, :1], 1.0)

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands times the factor."""
        return command * params[:, 3:]
