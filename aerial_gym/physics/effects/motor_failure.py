"""Motor failure in flight: from a given time on, one rotor follows a part of its command, or stops.

From the substep boundary nearest to ``time`` after the reset, the rotor approaches ``scale`` times the command, with its own
lag; before, the command. Thrust and drag torque follow from the speed as usual: with a quadratic thrust map, ``scale²`` of the
thrust remains.
Source: loss of effectiveness of an actuator, e.g. Zhang, Jiang (2008), Bibliographical review on reconfigurable fault-tolerant
control systems, section 2; with the lag it models a motor that runs down, not a broken propeller (``weak_motor``).
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, SubstepStart
from aerial_gym.physics.effects.failure import TIME, substep_middle
from aerial_gym.physics.effects.kinds.command import CommandEffect
from aerial_gym.physics.effects.one_rotor import ROTOR, rotor_mask
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class MotorFailure(CommandEffect):
    """A factor on the command of one rotor from a given time on."""

    name = "motor_failure"
    summary = "from a given time on one rotor follows a part of its command, or stops"
    parameters = (
        ROTOR,
        Parameter("scale", "-", 0.0, 2.0, 0.3, "speed, in force mode thrust, per command, after it", neutral=1.0),
        TIME,
    )
    excitation = "an episode that goes on after it; a log does not say when its reset was"
    confused_with = ("weak_motor", "com_offset")
    rotors = ANY_ROTOR
    memory = (1.0,)  # Factor on the command of the rotor
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the factor of this substep, (E, 1)."""
        middle = substep_middle(moment, values)
        return torch.where(middle.unsqueeze(-1) < values[:, 2:3], 1.0, values[:, 1:2])

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands with that of one rotor times the factor."""
        return command * (1.0 + rotor_mask(vehicle, params[:, 0]) * (params[:, 3:] - 1.0))
