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
        gains, state, task = self.law.gains, self.state, self.task
        error = task.target_position - state.position
        velocity = (
            task.values.own["target_velocity"] if "target_velocity" in task.values.own else torch.zeros_like(error)
        )
        damping = gains.velocity * (velocity - state.lin_vel)
        wanted = self.quicker * (self.quicker * gains.position * error + damping)
        if self.lead:
            wanted += self.leading(velocity, task.env.gtd["sim_steps"].unsqueeze(-1))
        ends = {"low": (-1.0,) * 4, "high": (1.0,) * 4, **task.cfg.action.params}
        low, high = (observation["observations"].new_tensor(ends[end]) for end in ("low", "high"))
        wanted = command(task.cfg.controller, self.law, state, wanted)
        return ((2.0 * wanted - low - high) / (high - low)).clamp(-1.0, 1.0)

    def leading(self, velocity: Tensor, age: Tensor) -> Tensor:
        """Return by what to lead [m/s²], (E, 3), from the target's velocity [m/s] and the steps since the start, (E, 1)."""
        change = torch.where(age > 0, velocity - self.velocity, 0.0) / self.dt
        jerk = torch.where(age > 1, change - self.change, 0.0) / self.dt
        self.velocity, self.change = velocity.clone(), change
        return change + jerk * (self.law.gains.rate / self.law.gains.attitude)[:, :1]
