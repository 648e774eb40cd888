"""A rotor that is stuck: from a moment on it keeps the speed that it has, whatever it is told.

From the boundary between two substeps on that is nearest to ``time`` after the reset the rotor tends to the speed, in force
mode the thrust, that it has there, and so keeps it. It is what a speed controller does that hears no more commands.
Source: lock in place, one of the failures of an actuator in Boskovic, Mehra (1999), Stable multiple model adaptive flight
control for accommodation of a large class of control effector failures, American Control Conference.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.base import ANY_ROTOR, Moment
from aerial_gym.physics.effects.failure import NEVER, TIME, middle_of
from aerial_gym.physics.effects.kinds.command import CommandEffect
from aerial_gym.physics.effects.one_rotor import ROTOR, chosen_rotor
from aerial_gym.physics.vehicle import Vehicle


class StuckRotor(CommandEffect):
    """One rotor that keeps its speed from a moment on."""

    name = "stuck_rotor"
    summary = "from a moment on one rotor keeps the speed that it has"
    parameters = (
        ROTOR,
        TIME,
    )
    excitation = "an episode that goes on after it; a log does not say when its reset was"
    confused_with = ("motor_failure",)
    rotors = ANY_ROTOR
    memory = (0.0, 0.0)
    """Whether it is stuck, and at which speed."""
    random = True

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return a moment that no episode lives to see."""
        del robot
        return 1.0, NEVER

    def remember(self, moment: Moment, values: Tensor) -> Tensor:
        """Return whether it is stuck in this substep, and at which speed, (E, 2)."""
        stuck = middle_of(moment, values) >= values[:, 1]
        now = (chosen_rotor(moment.vehicle, values[:, 0]) * moment.rotor_speed).sum(-1)
        kept = torch.where(values[:, 2] > 0.0, values[:, 3], now)
        return torch.stack((stuck.to(values.dtype), torch.where(stuck, kept, 0.0)), dim=-1)

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands with the kept speed in the place of one."""
        kept = chosen_rotor(vehicle, params[:, 0]) * params[:, 2:3] > 0.0
        return torch.where(kept, params[:, 3:], command)

    def replay_memory(self, voltage: Tensor) -> Tensor:
        """Return no failure, (T, 2)."""
        return torch.zeros_like(voltage).unsqueeze(-1).expand(-1, 2)

    def warp_remember(self, vehicle: type, moment: type) -> wp.Function:
        """Return the same in Warp."""

        @wp.func
        def sticking(plant: vehicle, now: moment, values: wp.vec4) -> wp.vec4:
            after = wp.vec4(values[0], values[1], 0.0, 0.0)
            if (float(now.since) + 0.5) * now.dt >= values[1]:
                after[2] = 1.0
                after[3] = values[3]
                if values[2] == 0.0:
                    for i in range(len(now.rotor_speed)):
                        if i + 1 == int(wp.round(values[0])):
                            after[3] = now.rotor_speed[i]
            return after

        return sticking

    def warp_command(self, vehicle: type, vector: type) -> wp.Function:
        """Return the same in Warp."""

        @wp.func
        def stuck_rotor(command: vector, plant: vehicle, values: wp.vec4) -> vector:
            followed = vector()
            for i in range(len(command)):
                stuck = values[2] > 0.0 and i + 1 == int(wp.round(values[0]))
                followed[i] = wp.where(stuck, values[3], command[i])
            return followed

        return stuck_rotor
