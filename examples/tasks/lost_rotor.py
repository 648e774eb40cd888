"""Hover with a rotor that fails, told or not told of it: ``python examples/tasks/lost_rotor.py [STARTS [LATE_S [SHARE]]]``.

Flies ``motor_failure_task`` by ``LeePilot``, which believes in its rotors, and by one that is told, LATE_S after it, which has
failed: it stops that rotor, gives the opposite one SHARE of the others, and spins. Prints, by what is left of the speed, the
share of flights that are lost [%] and the distance of the others in the last second [m].
"""

import sys
from collections.abc import Mapping
from dataclasses import replace

import torch
from lee_pilot import LeePilot
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.control.lost_rotor import lost_rotor_law
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.rl_training import evaluate


class InformedPilot(LeePilot):
    """Flies ``base_quadrotor_braked_in_spin`` without the rotor that has failed."""

    largest, late, share = 2.0, 0.0, 0.1  # of a thrust [N]; [s]; with a larger share it circles wider

    def __init__(self, *task) -> None:
        """Take what ``LeePilot`` does."""
        super().__init__(*task)
        self.robot = self.task.env.robot_manager
        self.spinning = lost_rotor_law(self.robot.cfg, self.task.env.sim_cfg.gravity, share=self.share)

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, 4)."""
        gtd = self.task.env.gtd
        motor, _, moment = gtd["effect_motor_failure"].unbind(-1)
        failed = (gtd["sim_steps"] * self.dt >= moment + self.late).unsqueeze(-1)
        speed = self.spinning.rotor_command(self.state, self.task.target_position, motor.long() - 1)
        told = (2.0 * rotor_thrust(self.robot.declared, speed) / self.largest - 1.0).clamp_max(1.0)
        return torch.where(failed, told, super().__call__(observation))


def main(starts: int) -> None:
    """Fly with more and with less of the rotor left, print a line for each flight."""
    cfg, drawn = task_registry.get("motor_failure_task"), "effects.motor_failure.scale"
    for low, high in ((0.0, 0.9), (0.6, 0.9), (0.0, 0.0)):
        left = {**cfg.randomize, drawn: replace(cfg.randomize[drawn], low=low, high=high)}
        task_registry.register(f"failure_{low}_{high}", replace(cfg, randomize=left))
        for pilot, name in ((LeePilot, "not told"), (InformedPilot, "told")):
            with task_registry.make_task(f"failure_{low}_{high}", num_envs=starts, device="cpu", seed=1) as task:
                found = evaluate(pilot(task), task)
            error = "nowhere" if found.final_error_mean_m is None else f"{found.final_error_mean_m:.3f} m beside it"
            print(f"{low} to {high} of the speed, {name}: {found.crash_rate:.1%} lost, the others end {error}")


if __name__ == "__main__":
    starts, late, share = (*sys.argv[1:], *("256", "0.0", "0.1")[len(sys.argv) - 1 :])
    InformedPilot.late, InformedPilot.share = float(late), float(share)
    main(int(starts))
