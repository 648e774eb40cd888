"""Navigation with a dome lidar by a rule without learning: ``python examples/tasks/backwards_by_lidar.py [STARTS]``.

Turns its back, where the lidar looks, to the goal of ``lidar_navigation_task``, flies toward what ``choose`` says, and turns to
the wanted heading once it is there. It sees what a policy sees, noise included, and its own yaw. Prints how many flights end
within 1 m of the goal and how many crash [%], among the fewest and the most obstacles of the curriculum.
"""

import sys
from collections.abc import Mapping
from math import pi

import torch
from steer import choose, fly
from torch import Tensor

from aerial_gym.math.quaternion import quat_from_yaw, quat_rotate, wrap_angle
from aerial_gym.task import Task


class BackwardsPilot:
    """Pilot that flies to one of the lidar's 16 x 20 cells; its gains were tuned on seed 1, which ``fly`` does not use."""

    def __init__(self, task: Task) -> None:
        """Take the task."""
        self.yaw = task.env.gtd["robot_euler_angles"][:, 2]
        row, column = (torch.arange(320) // 20 + 0.5) / 16.0, (torch.arange(320) % 20 + 0.5) / 20.0
        azimuth, elevation = pi - 2.0 * pi * column, 0.5 * pi * (1.0 - row)
        across = torch.cos(elevation)  # the zenith of the dome is body -x
        self.looks = torch.stack((-torch.sin(elevation), across * azimuth.sin(), across * azimuth.cos()), dim=-1)

    def reset(self, mask: Tensor | None = None) -> None:
        """Do nothing: the pilot has no memory."""

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, 4)."""
        state, inverse = observation["observations"].split((17, 320), dim=-1)
        goal, distance, heading, velocity = state[:, :3], state[:, 3], state[:, 6], state[:, 7:10]
        best, free = choose(self.looks.unsqueeze(0), 1.0 / inverse.view(-1, 16, 20), goal, turns=True)
        behind, there = wrap_angle(torch.atan2(goal[:, 1], goal[:, 0]) - pi), distance < 1.0
        speed = torch.minimum(0.5 * free, 0.7 * distance).clamp_max(2.0).where(behind.abs() < 0.5 * pi, 0.0)
        way = torch.where(there.unsqueeze(-1), goal, self.looks[best])
        wanted = quat_rotate(
            quat_from_yaw(self.yaw), 1.5 * (speed.unsqueeze(-1) * way - velocity)
        )  # [m/s²], 1.5 in 1/s
        turn = torch.where(there, heading, behind)
        return torch.cat((0.5 * wanted, turn.unsqueeze(-1)), dim=-1).clamp(-1.0, 1.0)


if __name__ == "__main__":
    fly("lidar_navigation_task", BackwardsPilot, starts=int(sys.argv[1]) if len(sys.argv) > 1 else 64)
