"""Draw flights of policies: ``python -m benchmarks.learning.flights OUT.png "LANDING=runs/landing" "LOST ROTOR=runs/failure"``.

A row for each run folder. Left: ways of a few fresh flights from above, about the target of each instant, the brighter the
faster, with a cross where one crashed. Right: the distance to the target over the time, of all flights that still fly: median,
middle half, middle nine tenths. ``--flights N`` flies N (200 if not given), ``--level L`` holds the curriculum there.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import torch
from matplotlib.axes import Axes
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.rl_training import load_policy

SEED = 1_000_003  # Of the starts: that of `aerial-gym evaluate`
SHOWN = 12  # Ways that are drawn
FASTEST = 0.98  # Share of the speeds that the scale of colours covers


@dataclass(frozen=True, kw_only=True)
class FirstEpisodes:
    """First episodes of some environments, NaN after their ends. Letters: E environments, T steps."""

    offset: Tensor  # Robot minus target [m], world, (E, T, 3)
    speed: Tensor  # [m/s], (E, T)
    crashed: Tensor  # Whether it ended as a crash, bool (E,)
    dt: float  # Time of a step [s]


@torch.no_grad()
def fly_policy(run: str, count: int, *, level: int | None = None) -> FirstEpisodes:
    """Return fresh flights of the policy in a run folder."""
    policy, cfg = load_policy(run)
    curriculum = task_registry.get(cfg.task).curriculum
    if curriculum is not None and level is None:
        level = curriculum.max_level
    made = task_registry.make_task(
        cfg.task, num_envs=count, device="cpu", seed=SEED, robot=cfg.robot, controller=cfg.controller,
        encoder=cfg.encoder, level=None if curriculum is None else level,
    )  # fmt: skip
    with made as task:
        observation, _ = task.reset()
        policy.reset()
        over, crashed = torch.zeros(count, dtype=torch.bool), torch.zeros(count, dtype=torch.bool)
        offsets, speeds = [], []
        for _ in range(task.cfg.episode_len_steps):
            gone = torch.where(over, torch.nan, 0.0)
            offsets.append(task.env.gtd["robot_position"] - task.target_position + gone.unsqueeze(-1))
            speeds.append(task.env.gtd["robot_linvel"].norm(dim=-1) + gone)
            observation, _, terminated, truncated, info = task.step(policy(observation))
            policy.reset(terminated | truncated)
            crashed |= info["crashes"] & ~over
            over |= terminated | truncated
            if over.all():
                break
        return FirstEpisodes(
            offset=torch.stack(offsets, dim=1), speed=torch.stack(speeds, dim=1), crashed=crashed, dt=task.env.dt
        )


def draw_ways(axis: Axes, flights: FirstEpisodes) -> None:
    """Draw the first flights from above, about their targets."""
    top = float(flights.speed[~flights.speed.isnan()].quantile(FASTEST))
    for way, speed, crashed in zip(flights.offset[:SHOWN], flights.speed[:SHOWN], flights.crashed[:SHOWN], strict=True):
        axis.scatter(way[:, 0], way[:, 1], c=speed, s=1.5, vmin=0.0, vmax=top, linewidths=0.0)
        last = way[~way[:, 0].isnan()][-1]
        axis.plot(*last[:2].tolist(), "x" if crashed else "o", color="tab:red" if crashed else "0.3", markersize=3)
    axis.set(xlabel="x from the target [m]", ylabel="y [m]", aspect="equal")


def draw_distances(axis: Axes, flights: FirstEpisodes) -> None:
    """Draw the distance to the target over the time."""
    distance = flights.offset.norm(dim=-1)
    time = flights.dt * torch.arange(distance.shape[1])
    shares = torch.tensor([0.05, 0.25, 0.5, 0.75, 0.95])
    low, quarter, middle, most, high = torch.nanquantile(distance, shares, dim=0)
    axis.fill_between(time, low, high, color="tab:blue", alpha=0.2, linewidth=0.0)
    axis.fill_between(time, quarter, most, color="tab:blue", alpha=0.4, linewidth=0.0)
    axis.plot(time, middle, color="tab:blue", linewidth=1.0)
    axis.set(xlabel="time [s]", ylabel="distance [m]", xlim=(0.0, None), ylim=(0.0, None))


def main(argv: Sequence[str]) -> None:
    """Fly and draw."""
    parser = ArgumentParser(prog="python -m benchmarks.learning.flights", description=__doc__)
    parser.add_argument("out", help="picture (.png)")
    parser.add_argument("runs", nargs="+", metavar="NAME=RUN")
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--level", type=int)
    asked = parser.parse_args(argv)
    plt.rcParams |= {"xtick.labelsize": 7, "ytick.labelsize": 7, "axes.labelsize": 8}
    figure, axes = plt.subplots(len(asked.runs), 2, figsize=(8.0, 2.6 * len(asked.runs)), squeeze=False)
    for (left, right), entry in zip(axes, asked.runs, strict=True):
        name, _, run = entry.partition("=")
        print(f"flying {name}", file=sys.stderr, flush=True)
        flights = fly_policy(run, asked.flights, level=asked.level)
        draw_ways(left, flights)
        draw_distances(right, flights)
        left.set_title(name, fontsize=9)
    figure.tight_layout()
    figure.savefig(asked.out, dpi=80)


if __name__ == "__main__":
    main(sys.argv[1:])
