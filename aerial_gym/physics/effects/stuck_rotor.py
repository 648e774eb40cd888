"""Stuck rotor: from a given time on, one rotor keeps its speed and ignores commands.

From the substep boundary nearest to ``time`` after the reset, the rotor holds its present speed, in force mode its thrust, as
a speed controller does without new commands.
Source: lock in place, one of the failures of an actuator in Boskovic, Mehra (1999), Stable multiple model adaptive flight
control for accommodation of a large class of control effector failures, American Control Conference.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, SubstepStart
from aerial_gym.physics.effects.failure import NEVER, TIME, substep_middle
from aerial_gym.physics.effects.kinds.command import CommandEffect
from aerial_gym.physics.effects.one_rotor import ROTOR, rotor_mask
from aerial_gym.physics.vehicle import Vehicle


class StuckRotor(CommandEffect):
    """Constant speed of one rotor from a given time on."""

    name = "stuck_rotor"
    summary = "from a given time on one rotor keeps its speed"
    parameters = (ROTOR, replace(TIME, neutral=NEVER))
    excitation = "an episode that goes on after it; a log does not say when its reset was"
    confused_with = ("motor_failure",)
    rotors = ANY_ROTOR
    memory = (0.0, 0.0)  # Whether it is stuck, and at which speed
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the flag of a stuck rotor in this substep, and its speed, (E, 2)."""
        stuck = substep_middle(moment, values) >= values[:, 1]
        now = (rotor_mask(moment.vehicle, values[:, 0]) * moment.rotor_speed).sum(-1)
        kept = torch.where(values[:, 2] > 0.0, values[:, 3], now)
        return torch.stack((stuck.to(values.dtype), torch.where(stuck, kept, 0.0)), dim=-1)

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands with that of the stuck rotor replaced by its speed."""
        kept = rotor_mask(vehicle, params[:, 0]) * params[:, 2:3] > 0.0
        return torch.where(kept, params[:, 3:], command)
