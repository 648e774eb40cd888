"""Draw the flights of a racing policy from above: ``python examples/race_picture.py RUN OUT.png [TASK]``.

Each panel is a track of its own: gates with the direction in which they are flown through, poles, and the way of the vehicle,
the brighter the faster.
"""

import sys
from collections.abc import Callable, Mapping

import matplotlib.pyplot as plt
import torch
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.rl_training import load_policy
from aerial_gym.task import Task

HALF = 0.36  # of a frame [m]


Pilot = Callable[[Mapping[str, Tensor]], Tensor]


def flights(pilot: Pilot, task: Task, observation: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Return places [m] and speeds [m/s] of the episodes that begin here, (E, T, 3) and (E, T); NaN after their ends."""
    over, places, speeds = torch.zeros(task.num_envs, dtype=torch.bool), [], []
    for _ in range(task.cfg.episode_len_steps):
        gone = torch.where(over, torch.nan, 0.0)
        places.append(task.env.gtd["robot_position"] + gone.unsqueeze(-1))
        speeds.append(task.env.gtd["robot_linvel"].norm(dim=-1) + gone)
        observation, _, terminated, truncated, _ = task.step(pilot(observation))
        over |= terminated | truncated
        if over.all():
            break
    return torch.stack(places, dim=1), torch.stack(speeds, dim=1)


def main(run: str, out: str, name: str = "racing_random_track_task") -> None:
    """Fly six tracks, draw a panel each."""
    policy, _ = load_policy(run)
    with task_registry.make_task(name, num_envs=6, device="cpu", seed=1_000_003) as task:
        observation, _ = task.reset()
        gtd = task.env.gtd
        gates, turns, poles = (gtd[key].clone() for key in ("gate_position", "gate_orientation", "pole_position"))
        along, across = (quat_rotate(turns, torch.tensor(axis).expand_as(gates)) for axis in ((1.0, 0, 0), (0, 1.0, 0)))
        places, speeds = flights(policy, task, observation)
    figure, axes = plt.subplots(2, 3, figsize=(10.0, 5.2))
    for e, axis in enumerate(axes.flat):
        for g, (middle, way, side) in enumerate(zip(gates[e], along[e], across[e], strict=True)):
            ends = torch.stack((middle - HALF * side, middle + HALF * side))
            axis.plot(ends[:, 0], ends[:, 1], color="0.2", linewidth=2.5)
            axis.arrow(*middle[:2].tolist(), *(0.3 * way[:2]).tolist(), width=0.02, color="0.2")
            axis.text(*(middle[:2] - 0.2 * way[:2]).tolist(), str(g + 1), fontsize=7)
        axis.plot(poles[e, :, 0], poles[e, :, 1], "x", color="tab:red", markersize=5)
        axis.scatter(places[e, :, 0], places[e, :, 1], c=speeds[e], s=2.0, vmin=0.0, vmax=4.0)
        axis.set(aspect="equal", xlim=(-3.0, 3.0), ylim=(-2.0, 2.0), xticks=(-2, 0, 2), yticks=(-1, 0, 1))
        axis.tick_params(labelsize=7)
    figure.tight_layout()
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
