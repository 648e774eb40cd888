"""A policy that has learned nothing, for tasks with a point to fly to; ``hold.py`` and ``follow.py`` fly it."""

from collections.abc import Mapping

import torch
from commands import command
from torch import Tensor

from aerial_gym.control import CONTROLLERS, LeeController
from aerial_gym.task import Task


class LeePilot:
    """Asks for the acceleration ``K_p e + K_v e'``, whatever the task takes, and knows the true state.

    Gains are those that the package derives from the vehicle, ``quicker`` times as quick.
    """

    def __init__(self, task: Task, *, quicker: float = 2.0, lead: bool = False) -> None:
        """Take the task; ``lead``: follow the target's acceleration, and its change for the lag ``K_w / K_R`` of attitude."""
        robot, law = task.env.robot_manager, CONTROLLERS.get("lee_acceleration_control")
        gravity, self.dt = task.env.sim_cfg.gravity, task.env.dt
        self.law = LeeController(law, robot.declared, gravity, dt=self.dt, control=robot.cfg.control)
        self.task, self.state, self.quicker, self.lead = task, robot.tensors.state, quicker, lead
        self.velocity = self.change = torch.zeros_like(self.state.position)

    def reset(self, mask: Tensor | None = None) -> None:
        """Do nothing: the steps of an episode say which have just begun."""

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, 4)."""
        cfg = self.task.cfg
        ends = {"low": (-1.0,) * 4, "high": (1.0,) * 4, **cfg.action.params}
        low, high = (observation["observations"].new_tensor(ends[end]) for end in ("low", "high"))
        wanted = command(cfg.controller, self.law, self.state, self.wanted())
        return ((2.0 * wanted - low - high) / (high - low)).clamp(-1.0, 1.0)

    def wanted(self) -> Tensor:
        """Return the acceleration to ask for [m/s²], world, (E, 3)."""
        gains, state = self.law.gains, self.state
        goal, velocity = self.goal()
        damping = gains.velocity * (velocity - state.lin_vel)
        wanted = self.quicker * (self.quicker * gains.position * (goal - state.position) + damping)
        if self.lead:
            wanted += self.leading(velocity, self.task.env.gtd["sim_steps"].unsqueeze(-1))
        return wanted

    def goal(self) -> tuple[Tensor, Tensor]:
        """Return where to be [m], world, and at which velocity [m/s], each (E, 3): the target of the task, and its own."""
        target = self.task.target_position
        return target, self.task.values.own.get("target_velocity", torch.zeros_like(target))

    def leading(self, velocity: Tensor, age: Tensor) -> Tensor:
        """Return by what to lead [m/s²], (E, 3), from the target's velocity [m/s] and the steps since the start, (E, 1)."""
        change = torch.where(age > 0, velocity - self.velocity, 0.0) / self.dt
        jerk = torch.where(age > 1, change - self.change, 0.0) / self.dt
        self.velocity, self.change = velocity.clone(), change
        return change + jerk * (self.law.gains.rate / self.law.gains.attitude)[:, :1]
