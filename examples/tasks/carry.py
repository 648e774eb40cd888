"""Carry a load on a rigid link to a point: ``python examples/tasks/carry.py [STARTS]``.

Flies ``payload_task`` by ``LeePilot``, which knows nothing of the load, and by one that knows what it weighs and follows its
swing. Prints the share of flights that end with the load at rest at its point [%], and how far the vehicle is from where it
belongs in the last second [m].
"""

import sys

from lee_pilot import LeePilot
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate


class LoadPilot(LeePilot):
    """Pilot that carries the load's weight and follows the swinging load, which damps the swing."""

    after = 1.0
    """Acceleration per velocity of the load relative to the vehicle [1/s]."""

    def target_acceleration(self) -> Tensor:
        """Return the acceleration setpoint [m/s²], world frame, (E, 3)."""
        gtd = self.task.env.gtd
        swing = gtd["load_linvel"] - gtd["robot_linvel"]
        wanted = super().target_acceleration() + self.after * swing
        wanted[:, 2] += self.law.gains.gravity * gtd["effect_slung_payload"][:, 0] / gtd["robot_mass"]
        return wanted


def main(starts: int) -> None:
    """Fly, print a line for each pilot."""
    for pilot in (LeePilot, LoadPilot):
        with task_registry.make_task("payload_task", num_envs=starts, device="cpu", seed=1) as task:
            result = evaluate(pilot(task, quicker=1.0), task)
        print(
            f"{pilot.__name__}: {result.success_rate:.1%} hold it, {result.final_error_mean_m or 0.0:.3f} m beside it"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 256)
