"""Touch down on a platform that drives: ``python examples/tasks/land.py [STARTS]``.

Flies ``platform_landing_task`` by ``LeePilot`` in two ways: straight to where the vehicle would stand, and over it first, then
down with it at 0.4 m/s. Prints the shares of flights that touch down on it gently and that crash or touch otherwise [%].
"""

import sys

import torch
from lee_pilot import LeePilot
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate


class LandingPilot(LeePilot):
    """Pilot that flies to a point above the target, follows it, and then descends."""

    over, down, near, slow = 0.3, 0.4, 0.25, 0.4  # [m], [m/s], [m], [m/s]

    def goal(self) -> tuple[Tensor, Tensor]:
        """Return the setpoints of position [m] and velocity [m/s], world frame, each (E, 3)."""
        target, velocity = (each.clone() for each in super().goal())
        away, haste = self.state.position - target, self.state.lin_vel - velocity
        beside = (away[:, :2].norm(dim=-1) > self.near) | (haste[:, :2].norm(dim=-1) > self.slow)
        target[:, 2] = torch.where(beside, target[:, 2] + self.over, self.state.position[:, 2])
        velocity[:, 2] -= torch.where(beside, 0.0, self.down)
        return target, velocity


def main(starts: int) -> None:
    """Fly, print a line for each way."""
    for pilot in (LeePilot, LandingPilot):
        with task_registry.make_task("platform_landing_task", num_envs=starts, device="cpu", seed=1) as task:
            result = evaluate(pilot(task, quicker=1.5), task)
        told = f"{result.success_rate:.1%} touch down, {result.crash_rate:.1%} crash"
        print(f"{pilot.__name__}: {told}, after {result.success_time_mean_s or 0.0:.2f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 256)
