"""``aerial-gym play``: flights of a trained policy as a CSV table or a film, or the last steps of rows that were not finite."""

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from aerial_gym.cli.film import Film, check_film, write_visible_robot
from aerial_gym.config.storage import storage_errors
from aerial_gym.errors import ConfigError

COLUMNS = [
    "t", "env", "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w", "v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PlayCmd:
    """Fly a trained policy and write its motion as CSV."""

    policy: Path | None = None  # Run folder of a training, for its last checkpoint, or one checkpoint in it

    replay: Path | None = None
    """In place of a policy: what a watch kept of rows that were not finite (``train --watch``, ``evaluate --watch FILE``)."""

    robot: str | None = None  # Registered robot, or a robot file, in place of the training's
    backend: str | None = None  # Registered physics backend (aerial-gym list backends); that of the sim if not given
    num_envs: int = 4  # Environments side by side
    num_steps: int = 500  # Environment steps; an environment whose episode ends starts anew
    seed: int = 1_000_003  # Seed of the starts
    out: Path | None = None  # CSV file; stdout if not given

    video: Path | None = None
    """Film of the first environment (.gif, .webp or .png), from a camera behind its robot. The robot is then visible, to its
    own sensors too. Without --out no table is written."""

    def run(self) -> int:
        """Fly, and write one row per step and environment: world frame, body rates, SI units; or show a dump of a watch."""
        if (self.policy is None) == (self.replay is None):
            raise ConfigError("play: give exactly one of --policy and --replay")
        if self.replay is not None:
            return self._write_non_finite_steps(self.replay)
        assert self.policy is not None
        if self.video is not None:
            check_film(self.video)
        from aerial_gym.interop import one_thread
        from aerial_gym.rl_training.policies.load import check_fits, load_policy
        from aerial_gym.task import task_registry

        policy, cfg = load_policy(self.policy)
        robot = self.robot or cfg.robot
        with TemporaryDirectory() as folder:
            if self.video is not None:
                robot = write_visible_robot(robot or task_registry.get(cfg.task).robot, folder)
            made = task_registry.make_task(
                cfg.task, num_envs=self.num_envs, device="cpu", seed=self.seed, robot=robot,
                controller=cfg.controller, backend=self.backend, encoder=cfg.encoder,
            )  # fmt: skip
            with made as task, one_thread():
                check_fits(policy, task, cfg.task)
                film = None if self.video is None else Film(task)
                rows = _flight_rows(policy, task, self.num_steps, film)
                if film is not None and self.video is not None:
                    with storage_errors(self.video, only_full=True):
                        film.save(self.video)
        if film is None or self.out is not None:
            self._write_rows([COLUMNS, *rows])
        return 0

    def _write_non_finite_steps(self, dump: Path) -> int:
        """Print which numbers of each row were NaN or infinite on stderr, and write the last steps of the row."""
        from aerial_gym.robots.finite_watch import read_dump

        table, sentences = read_dump(dump)
        for sentence in sentences:
            print(sentence, file=sys.stderr)
        self._write_rows(table)
        return 0

    def _write_rows(self, rows: Sequence[Sequence[object]]) -> None:
        if self.out is None:
            csv.writer(sys.stdout, lineterminator="\n").writerows(rows)
            return
        with storage_errors(self.out, only_full=True), self.out.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(rows)


@torch.no_grad()
def _flight_rows(policy, task, num_steps: int, film: Film | None) -> list[list[float]]:
    """Fly, and return the rows of ``COLUMNS``: one for each step and environment."""
    gtd, rows, began = task.env.gtd, [], True
    observation, _ = task.reset()
    policy.reset()
    for step in range(num_steps + 1):
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
        motion = torch.cat([gtd[key] for key in keys], dim=-1).tolist()
        if film is not None:
            film.render_frame(begins=began)
        rows += [[round(step * task.env.dt, 6), env, *values] for env, values in enumerate(motion)]
        if step < num_steps:
            observation, _, terminated, truncated, _ = task.step(policy(observation))
            policy.reset(terminated | truncated)
            began = bool((terminated | truncated)[0])
    return rows
