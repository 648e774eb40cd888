"""Fly policies on the vehicle whose arms bend: ``python -m benchmarks.joints.morphy_policies [--flights N] RUN [RUN ...]``.

Each run folder is one policy, learned with or without joints. It flies ``morphy``, and one that knows no joints
``morphy_stiff`` too, from fresh starts for an episode. Prints a JSON object a line: share of flights that crash, and of the
others, of the first second and of the last, the distance to the target [m], the tilt [rad], and of the joints the mean angle of
the elevations [rad], the spread of each joint about its own mean [rad] and the rates [rad/s], all rms.

``--picture FILE`` draws, over the first two seconds, the rms over the same starts of joint angles about those of hover, of
joint rates and of the distance: median and range of the policies that know joints and of those that do not.
"""

import json
from argparse import ArgumentParser
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.rl_training import load_policy

SEED = 1_000_003
"""Of the starts: that of ``aerial-gym evaluate``."""

SHOWN_S = 2.0
"""Of a flight in the picture [s]."""


@torch.no_grad()
def flown(run: str, robot: str, flights: int) -> tuple[list[Tensor], Tensor, float]:
    """Return of one policy on one robot what it flew, (E, T, ...) each, what crashed, (E,), and the length of a step [s].

    What it flew is the way from the target [m], roll and pitch [rad], and where there are joints their angles [rad] and rates.
    """
    policy, cfg = load_policy(run)
    with task_registry.make_task(cfg.task, num_envs=flights, device="cpu", seed=SEED, robot=robot) as flight:
        gtd = flight.env.gtd
        observation, _ = flight.reset()
        policy.reset()
        crashed, steps = torch.zeros(flights, dtype=torch.bool), []
        for _ in range(flight.cfg.episode_len_steps - 1):
            observation, _, terminated, truncated, _ = flight.step(policy(observation))
            policy.reset(terminated | truncated)
            crashed |= terminated
            joints = (gtd["dof_position"], gtd["dof_velocity"]) if "dof_position" in gtd else ()
            seen = (gtd["robot_position"] - flight.target_position, gtd["robot_euler_angles"][:, :2], *joints)
            steps.append([each.clone() for each in seen])
        dt = flight.env.dt
    return [torch.stack(each, dim=1) for each in zip(*steps, strict=True)], crashed, dt


def figures(of: list[Tensor], prefix: str) -> dict[str, float]:
    """Return the figures of a part of some flights, (E, T, ...) each."""
    found = {"distance_rms_m": _rms(of[0].norm(dim=-1)), "tilt_rms_rad": _rms(of[1].norm(dim=-1))}
    if len(of) > 2:
        found |= {
            "elevation_mean_rad": float(of[2][..., ::2].mean()),
            "joint_spread_rms_rad": _rms(of[2] - of[2].mean(dim=1, keepdim=True)),
            "joint_rate_rms_rad_s": _rms(of[3]),
        }
    return {f"{prefix}_{name}": value for name, value in found.items()}


def _rms(values: Tensor) -> float:
    return float(values.square().mean().sqrt())


def over_time(of: list[Tensor]) -> list[Tensor]:
    """Return, (T,) each, the rms over flights of joint angles about their last [rad], joint rates [rad/s] and distance [m]."""
    hover = of[2][:, -1:].mean(dim=0, keepdim=True)
    joints, rates = ((each.square().mean(dim=(0, 2))).sqrt() for each in (of[2] - hover, of[3]))
    return [joints, rates, of[0].norm(dim=-1).square().mean(dim=0).sqrt()]


def draw(file: str, curves: dict[str, list[list[Tensor]]], dt: float) -> None:
    """Draw curves by name and run."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = ("joint angles about hover, rms [rad]", "joint rates, rms [rad/s]", "distance, rms [m]")
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), constrained_layout=True)
    for color, (label, runs) in zip(("tab:blue", "tab:orange"), curves.items(), strict=False):
        for axis, name, of_runs in zip(axes, names, zip(*runs, strict=True), strict=True):
            values = torch.stack(of_runs)[:, : round(SHOWN_S / dt)]
            time = dt * (1.0 + torch.arange(values.shape[1]))
            axis.fill_between(time, values.amin(dim=0), values.amax(dim=0), color=color, alpha=0.25, linewidth=0)
            axis.plot(time, values.median(dim=0).values, color=color, label=f"{label} ({len(runs)} seeds)")
            axis.set(xlabel="time [s]", title=name, yscale="log")
            axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(file, dpi=80)


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--picture")
    given = parser.parse_args()
    curves: dict[str, list[list[Tensor]]] = {}
    step = 0.0
    for run in given.runs:
        rigid = "stiff" in load_policy(run)[1].task
        for robot in ("morphy", "morphy_stiff") if rigid else ("morphy",):
            of, crashed, step = flown(run, robot, given.flights)
            kept, second = [each[~crashed] for each in of], round(1.0 / step)
            found = {"run": Path(run).name, "robot": robot, "crashes": float(crashed.float().mean())}
            found |= figures([each[:, :second] for each in kept], "first")
            found |= figures([each[:, -second:] for each in kept], "last")
            print(json.dumps(found), flush=True)
            if robot == "morphy":
                curves.setdefault("learned on rigid arms" if rigid else "sees the joints", []).append(over_time(kept))
    if given.picture is not None:
        draw(given.picture, curves, step)


if __name__ == "__main__":
    main()
