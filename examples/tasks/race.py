"""Through gates that stand one over the other: ``python examples/tasks/race.py [STARTS]``.

Flies ``racing_split_s_task`` by ``LeePilot``: to a point before the next gate, and along its axis once it is near that. Prints
the share of complete runs and of crashes [%], the gates that a run passes, and the time of a complete one [s].
"""

import sys

import torch
from lee_pilot import LeePilot
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate


class RacingPilot(LeePilot):
    """Pilot with a near position setpoint and a speed by the remaining distance: the position loop suits errors of a metre."""

    before, reach, near, slowest, fastest = 1.5, 1.0, 0.6, 2.0, 8.0  # [m], [m], [m], [m/s], [m/s]

    def goal(self) -> tuple[Tensor, Tensor]:
        """Return the setpoints of position [m] and velocity [m/s], world frame, each (E, 3)."""
        gate, direction = self.task.target_position, self.task.values.own["target_direction"]
        axis = torch.cat((direction, torch.zeros_like(direction[:, :1])), dim=-1)
        away = self.state.position - gate
        along = (away * axis).sum(-1, keepdim=True)  # < 0 before the gate
        beside = (away - along * axis).norm(dim=-1, keepdim=True)
        through = (along < 0.0) & (along > -2.0 * self.before) & (beside < self.near)
        error = torch.where(through, gate + axis, gate - self.before * axis) - self.state.position
        size = error.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        velocity = error / size * size.clamp(self.slowest, self.fastest)
        return self.state.position + error / size * size.clamp_max(self.reach), velocity


def main(starts: int) -> None:
    """Fly, print a line."""
    with task_registry.make_task("racing_split_s_task", num_envs=starts, device="cpu", seed=1) as task:
        result = evaluate(RacingPilot(task), task)
    told = f"{result.success_rate:.1%} complete, {result.crash_rate:.1%} crash, {result.gates_passed_mean:.2f} gates"
    print(f"racing_split_s_task: {told}, {result.success_time_mean_s or 0.0:.2f} s for a run")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 64)
