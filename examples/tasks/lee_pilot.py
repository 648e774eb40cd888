"""A policy without learning for tasks with a position setpoint; ``hold.py`` and ``follow.py`` fly it."""

from collections.abc import Mapping

import torch
from commands import command
from torch import Tensor

from aerial_gym.control import CONTROLLERS, LeeController
from aerial_gym.task import Task


class LeePilot:
    """Pilot that commands the acceleration ``K_p e + K_v e'`` from the true state, through any task's action.

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
        """Do nothing: the step number of an episode shows its start."""

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, 4)."""
        cfg = self.task.cfg
        ends = {"low": (-1.0,) * 4, "high": (1.0,) * 4, **cfg.action.params}
        low, high = (observation["observations"].new_tensor(ends[end]) for end in ("low", "high"))
        wanted = command(cfg.controller, self.law, self.state, self.target_acceleration())
        return ((2.0 * wanted - low - high) / (high - low)).clamp(-1.0, 1.0)

    def target_acceleration(self) -> Tensor:
        """Return the acceleration setpoint [m/s²], world frame, (E, 3)."""
        gains, state = self.law.gains, self.state
        goal, velocity = self.goal()
        damping = gains.velocity * (velocity - state.lin_vel)
        wanted = self.quicker * (self.quicker * gains.position * (goal - state.position) + damping)
        if self.lead:
            wanted += self.lead_acceleration(velocity, self.task.env.gtd["sim_steps"].unsqueeze(-1))
        return wanted

    def goal(self) -> tuple[Tensor, Tensor]:
        """Return the position [m] and velocity [m/s] of the task's target, world frame, each (E, 3)."""
        target = self.task.target_position
        return target, self.task.values.own.get("target_velocity", torch.zeros_like(target))

    def lead_acceleration(self, velocity: Tensor, age: Tensor) -> Tensor:
        """Return the feed-forward acceleration [m/s²], (E, 3), from the target's velocity [m/s] and the step number, (E, 1)."""
        change = torch.where(age > 0, velocity - self.velocity, 0.0) / self.dt
        jerk = torch.where(age > 1, change - self.change, 0.0) / self.dt
        self.velocity, self.change = velocity.clone(), change
        return change + jerk * (self.law.gains.rate / self.law.gains.attitude)[:, :1]
