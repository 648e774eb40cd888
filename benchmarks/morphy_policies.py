"""Fly policies on the vehicle whose arms bend: ``python -m benchmarks.morphy_policies [--flights N] RUN [RUN ...]``.

Each run folder is one policy, learned with or without joints. It flies ``morphy``, and one that knows no joints
``morphy_stiff`` too, from fresh starts for an episode. Prints a JSON object a line: share of flights that crash, and of the
others in the last second the distance to the target [m], the tilt [rad], and of the joints the mean angle of the elevations
[rad], the spread of each joint about its own mean [rad] and the rates [rad/s], all rms.
"""

import json
from argparse import ArgumentParser
from pathlib import Path

import torch

from aerial_gym import task_registry
from aerial_gym.rl_training import load_policy

SEED = 1_000_003
"""Of the starts: that of ``aerial-gym evaluate``."""


@torch.no_grad()
def flown(run: str, robot: str, flights: int) -> dict[str, object]:
    """Return the figures of one policy on one robot."""
    policy, cfg = load_policy(run)
    with task_registry.make_task(cfg.task, num_envs=flights, device="cpu", seed=SEED, robot=robot) as flight:
        gtd = flight.env.gtd
        observation, _ = flight.reset()
        policy.reset()
        crashed, last = torch.zeros(flights, dtype=torch.bool), []
        steps, second = flight.cfg.episode_len_steps, round(1.0 / flight.env.dt)
        for step in range(steps - 1):
            observation, _, terminated, truncated, _ = flight.step(policy(observation))
            policy.reset(terminated | truncated)
            crashed |= terminated
            if step >= steps - 1 - second:
                joints = (gtd["dof_position"], gtd["dof_velocity"]) if "dof_position" in gtd else ()
                seen = (gtd["robot_position"] - flight.target_position, gtd["robot_euler_angles"][:, :2], *joints)
                last.append([each.clone() for each in seen])
        kept = [torch.stack(each, dim=1)[~crashed] for each in zip(*last, strict=True)]
    found: dict[str, object] = {
        "run": Path(run).name,
        "robot": robot,
        "crashes": float(crashed.float().mean()),
        "distance_rms_m": _rms(kept[0].norm(dim=-1)),
        "tilt_rms_rad": _rms(kept[1].norm(dim=-1)),
    }
    if len(kept) > 2:
        found |= {
            "elevation_mean_rad": float(kept[2][..., ::2].mean()),
            "joint_spread_rms_rad": _rms(kept[2] - kept[2].mean(dim=1, keepdim=True)),
            "joint_rate_rms_rad_s": _rms(kept[3]),
        }
    return found


def _rms(values: torch.Tensor) -> float:
    return float(values.square().mean().sqrt())


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--flights", type=int, default=1000)
    given = parser.parse_args()
    for run in given.runs:
        robots = ("morphy", "morphy_stiff") if "stiff" in load_policy(run)[1].task else ("morphy",)
        for robot in robots:
            print(json.dumps(flown(run, robot, given.flights)), flush=True)


if __name__ == "__main__":
    main()
