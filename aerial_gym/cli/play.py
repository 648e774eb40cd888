"""``aerial-gym play``: flights of a policy as table, film or recording, or the last steps of rows that were not finite."""

import csv
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.cli.film import MOST_VIEWS, Film, check_film
from aerial_gym.config.changes import settings_of_run
from aerial_gym.config.set_option import SetOption
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

    set: SetOption = ()
    """Setting of task, robot, env or sim in place of its own, such as robot.body.mass=0.3; can be repeated. Those of the
    training apply too."""

    out: Path | None = None  # CSV file; stdout if not given

    video: Path | None = None
    """Film (.gif, .webp, .png or .mp4): a camera behind the robot of each environment, and what its sensors see. Without
    --out no table is written."""

    video_envs: int | None = None  # Environments in the film; the first 4 if not given

    record: Path | None = None
    """Recording (.mcap) of all environments for Foxglove or Lichtblick, with the sensors of the first one. What is written
    when play is stopped stays readable. Without --out no table is written."""

    def run(self) -> int:
        """Fly, and write one row per step and environment: world frame, body rates, SI units; or show a dump of a watch."""
        if (self.policy is None) == (self.replay is None):
            raise ConfigError("play: give exactly one of --policy and --replay")
        if self.replay is not None:
            return self._write_non_finite_steps(self.replay)
        assert self.policy is not None
        views = self._check_outputs()
        from aerial_gym.interop import one_thread
        from aerial_gym.rl_training.policies.load import check_fits, load_policy
        from aerial_gym.task import task_registry

        policy, cfg = load_policy(self.policy)
        made = task_registry.make_task(
            cfg.task, num_envs=self.num_envs, device="cpu", seed=self.seed, robot=self.robot or cfg.robot,
            controller=cfg.controller, backend=self.backend, encoder=cfg.encoder,
            settings=(*settings_of_run(cfg.settings, robot=self.robot, task=None), *self.set),
        )  # fmt: skip
        with made as task, one_thread(), ExitStack() as stack:
            check_fits(policy, task, cfg.task)
            rows, observers = list[list[float]](), list[Callable[[Tensor], None]]()
            if self.out is not None or self.video is self.record is None:
                stack.callback(self._write_rows, rows)
            if self.video is not None:
                film = Film(task, views)
                stack.callback(film.save, self.video)
                observers.append(film.render_frame)
            if self.record is not None:
                from aerial_gym.cli.record import FlightRecorder

                recorder = FlightRecorder(task, self.record)
                stack.callback(recorder.close)
                observers.append(recorder.write_step)
            _fly(policy, task, self.num_steps, rows, observers)
        return 0

    def _check_outputs(self) -> int:
        """Return the number of environments in the film; raise an error if it, or a file, is impossible."""
        views = min(MOST_VIEWS, self.num_envs) if self.video_envs is None else self.video_envs
        if not 1 <= views <= self.num_envs:
            raise ConfigError(f"--video-envs {views}: must be 1 to {self.num_envs}, the value of --num-envs")
        if self.video is not None:
            check_film(self.video)
        if self.record is not None and self.record.suffix != ".mcap":
            raise ConfigError(f"--record {self.record}: must end in .mcap")
        return views

    def _write_non_finite_steps(self, dump: Path) -> int:
        """Print which numbers of each row were NaN or infinite on stderr, and write the last steps of the row."""
        from aerial_gym.robots.finite_watch import read_dump

        table, sentences = read_dump(dump)
        for sentence in sentences:
            print(sentence, file=sys.stderr)
        self._write_rows(table[1:], table[0])
        return 0

    def _write_rows(self, rows: Sequence[Sequence[object]], head: Sequence[object] = COLUMNS) -> None:
        if self.out is None:
            csv.writer(sys.stdout, lineterminator="\n").writerows([head, *rows])
            return
        with storage_errors(self.out, only_full=True), self.out.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([head, *rows])


@torch.no_grad()
def _fly(policy, task, num_steps: int, rows: list[list[float]], observers: Sequence[Callable[[Tensor], None]]) -> None:
    """Fly, append the rows of ``COLUMNS``, one for each step and environment, and show each step to the observers.

    An observer receives which environments begin an episode, bool (E,).
    """
    gtd, begins = task.env.gtd, torch.ones(task.num_envs, dtype=torch.bool)
    observation, _ = task.reset()
    policy.reset()
    for step in range(num_steps + 1):
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
        motion = torch.cat([gtd[key] for key in keys], dim=-1).tolist()
        rows += [[round(step * task.env.dt, 6), env, *values] for env, values in enumerate(motion)]
        for show_step in observers:
            show_step(begins)
        if step < num_steps:
            observation, _, terminated, truncated, _ = task.step(policy(observation))
            begins = terminated | truncated
            policy.reset(begins)
