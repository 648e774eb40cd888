"""Navigation with a camera by a rule without learning: ``python examples/tasks/through_obstacles.py [STARTS [TASK ...]]``.

Turns and flies in the direction that ``choose`` returns, more slowly in front of obstacles. It has the policy's observations,
noise included: cells in ``navigation_task`` (the default), logarithms of cells in ``safe_navigation_task``, images in
``pixel_navigation_task``. Prints the shares of arrivals within 1 m and of crashes [%], with the fewest and the most obstacles.
"""

import sys
from collections.abc import Mapping
from math import radians, tan

import torch
from steer import choose, fly
from torch import Tensor
from torch.nn.functional import max_pool2d

from aerial_gym.task import Task


class ForwardPilot:
    """Pilot that flies to one of the camera's 8 x 8 cells; its gains were tuned on seed 1, which ``fly`` does not use."""

    def __init__(self, task: Task) -> None:
        """Take the task."""
        wide = 2.0 * tan(0.5 * radians(87.0))  # width of the image at 1 m: coarse_depth_camera, as is its range of 10 m
        left, up = wide * (0.5 - (torch.arange(8) + 0.5) / 8.0), 0.6 * wide * (0.5 - (torch.arange(8) + 0.5) / 8.0)
        self.azimuth, self.elevation = torch.atan(left).repeat(8), torch.atan(up).repeat_interleave(8)
        self.terms, self.largest = [entry.term for entry in task.cfg.observations["policy"]], task.cfg.action.params

    def reset(self, mask: Tensor | None = None) -> None:
        """Do nothing: the pilot has no memory."""

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, 4)."""
        state, cells = observation["observations"].tensor_split((17,), dim=-1)
        if "depth" in observation:
            cells = -max_pool2d(-observation["depth"].float() / 255.0, (3, 5))
        share = cells.exp() if "log_nearest_in_cells" in self.terms else cells
        nearest, distance = 10.0 * share.view(-1, 8, 8), state[:, 3]
        elevation = self.elevation - state[:, 5:6]  # of the pitch
        level = torch.cos(elevation)
        looks = torch.stack((level * self.azimuth.cos(), level * self.azimuth.sin(), elevation.sin()), dim=-1)
        best, _ = choose(looks, nearest, state[:, :3], turns=False)
        climb, turn = elevation.gather(1, best.unsqueeze(-1))[:, 0], self.azimuth[best]
        ahead = nearest[:, 2:6, 2:6].amin((1, 2))
        speed = torch.minimum(0.8 * (ahead - 0.3).clamp_min(0.0), distance) * turn.cos()
        speed = torch.where(distance < 0.5, 0.0, speed)
        wanted = torch.stack((speed, climb, 2.0 * turn), dim=-1)
        limits = [self.largest[f"max_{label}"] for label in ("speed", "inclination", "yaw_rate")]
        share = wanted / wanted.new_tensor(limits)
        return torch.stack((2.0 * share[:, 0] - 1.0, share[:, 1], share[:, 2], 0.0 * speed), dim=-1).clamp(-1.0, 1.0)


if __name__ == "__main__":
    starts = int(sys.argv[1]) if len(sys.argv) > 1 else 64
    for name in sys.argv[2:] or ("navigation_task",):
        fly(name, ForwardPilot, starts=starts, robot="base_quadrotor_with_coarse_camera")
