"""Hover with a rotor that fails, told or not told of it: ``python examples/tasks/lost_rotor.py [STARTS]``.

Flies ``motor_failure_task`` by ``LeePilot``, which believes in its rotors, and by one that knows which rotor has failed and how
much of it is left: it gives up its heading as far as that is needed. Prints, by what is left of the speed, the share of flights
that are lost [%] and the distance of the others in the last second [m].
"""

import sys
from collections.abc import Mapping
from dataclasses import replace

import torch
from lee_pilot import LeePilot
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate


class InformedPilot(LeePilot):
    """Flies ``base_quadrotor`` by thrusts that its rotors can give."""

    largest, heading = 2.0, torch.tensor((1.0, -1.0, 1.0, -1.0))  # of a thrust [N]; those that turn it about z alone

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, 4)."""
        gtd = self.task.env.gtd
        motor, scale, time = gtd["effect_motor_failure"].unbind(-1)
        failed = (torch.arange(1, 5) == motor.unsqueeze(-1)) & (gtd["sim_steps"] * self.dt >= time).unsqueeze(-1)
        left = torch.where(failed, scale.unsqueeze(-1).square(), 1.0)  # of the thrust
        wanted = 0.5 * self.largest * (super().__call__(observation) + 1.0)
        turning = (wanted * self.heading).mean(-1, keepdim=True)
        without = wanted - turning * self.heading
        ends = self.heading * torch.stack((-without, left * self.largest - without))  # of ``turning``, rotor by rotor
        turning = turning.maximum(ends.amin(0).amax(-1, keepdim=True)).minimum(ends.amax(0).amin(-1, keepdim=True))
        told = (without + turning * self.heading) / left.clamp_min(1e-3)
        return (2.0 * told / self.largest - 1.0).clamp(-1.0, 1.0)


def main(starts: int) -> None:
    """Fly with more and with less of the rotor left, print a line for each flight."""
    cfg, drawn = task_registry.get("motor_failure_task"), "effects.motor_failure.scale"
    for low, high in ((0.0, 0.9), (0.6, 0.9), (0.0, 0.3)):
        part = replace(cfg, randomize={**cfg.randomize, drawn: replace(cfg.randomize[drawn], low=low, high=high)})
        task_registry.register(f"motor_failure_{low}_{high}_task", part)
        for pilot, name in ((LeePilot, "not told"), (InformedPilot, "told")):
            with task_registry.make_task(
                f"motor_failure_{low}_{high}_task", num_envs=starts, device="cpu", seed=1
            ) as task:
                found = evaluate(pilot(task), task)
            error = "nowhere" if found.final_error_mean_m is None else f"{found.final_error_mean_m:.3f} m beside it"
            print(f"{low} to {high} of the speed, {name}: {found.crash_rate:.1%} lost, the others end {error}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 256)
