"""``aerial-gym play``: flights of a trained policy as a CSV table."""

import csv
import sys
from dataclasses import dataclass
from pathlib import Path

import torch

COLUMNS = (
    "t",
    "env",
    "p_x",
    "p_y",
    "p_z",
    "q_x",
    "q_y",
    "q_z",
    "q_w",
    "v_x",
    "v_y",
    "v_z",
    "omega_x",
    "omega_y",
    "omega_z",
)


@dataclass(frozen=True, kw_only=True)
class PlayCmd:
    """Fly a trained policy and write its motion as CSV."""

    policy: Path
    """Run folder of a training, of which the last checkpoint is taken, or one checkpoint in it."""

    robot: str | None = None
    """Registered robot, or a robot file, in place of the training's."""

    num_envs: int = 4
    """Environments side by side."""

    num_steps: int = 500
    """Environment steps; an environment whose episode ends starts anew."""

    seed: int = 1_000_003
    """Seed of the starts."""

    out: Path | None = None
    """CSV file; stdout if not given."""

    def run(self) -> int:
        """Fly, and write one row per step and environment: world frame, body rates, SI units."""
        from aerial_gym.interop import one_thread
        from aerial_gym.rl_training.policy import load_policy
        from aerial_gym.task import task_registry

        policy, cfg = load_policy(self.policy)
        with (
            task_registry.make_task(
                cfg.task,
                num_envs=self.num_envs,
                device="cpu",
                seed=self.seed,
                robot=self.robot or cfg.robot,
                controller=cfg.controller,
            ) as task,
            one_thread(),
        ):
            rows = _fly(policy, task, self.num_steps)
        if self.out is None:
            _write(rows, sys.stdout)
        else:
            with self.out.open("w", encoding="utf-8", newline="") as file:
                _write(rows, file)
        return 0


@torch.no_grad()
def _fly(policy, task, num_steps: int) -> list[list[float]]:
    gtd, rows = task.env.gtd, []
    observation, _ = task.reset()
    for step in range(num_steps + 1):
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
        motion = torch.cat([gtd[key] for key in keys], dim=-1).tolist()
        rows += [[round(step * task.env.dt, 6), env, *values] for env, values in enumerate(motion)]
        if step < num_steps:
            observation, *_ = task.step(policy(observation["observations"]))
    return rows


def _write(rows: list[list[float]], file) -> None:
    writer = csv.writer(file)
    writer.writerow(COLUMNS)
    writer.writerows(rows)
