"""``aerial-gym play``: flights of a policy as table, film or recording, or the last steps of rows that were not finite."""

import csv
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.config.set_option import SetOption
from aerial_gym.config.storage import storage_errors
from aerial_gym.errors import ConfigError, UnknownNameError, suggest_name
from aerial_gym.extras import require

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

COLUMNS = [
    "t", "env", "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w", "v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True, repr=False)
class FlightTable:
    """Motion of ``play``: a row per step and environment, in the world frame with body rates, in SI units."""

    columns: Sequence[str]  # Names of the columns
    rows: Sequence[Sequence[object]]  # Rows in the order of time
    num_envs: int | None  # Number of environments; None for the rows of ``replay``

    def __getitem__(self, column: str) -> "np.ndarray":
        """Return a column: a row per step and a column per environment; (N,) for the rows of ``replay``."""
        import numpy as np

        if column not in self.columns:
            hint = suggest_name(column, self.columns)
            raise UnknownNameError(f"no column {column!r}.{hint} Known: {', '.join(self.columns)}")
        place = self.columns.index(column)
        values = np.array([row[place] for row in self.rows])
        return values if self.num_envs is None else values.reshape(-1, self.num_envs)

    def __repr__(self) -> str:
        envs = "" if self.num_envs is None else f" of {self.num_envs} environments"
        return f"FlightTable: {len(self.rows):,} rows{envs}; columns {', '.join(self.columns)}"


@dataclass(frozen=True, kw_only=True)
class PlayCmd:
    """Fly a trained policy and write its motion as CSV."""

    policy: Path | None = field(default=None, kw_only=False)
    """Run folder of a training, for its last checkpoint, one checkpoint in it, or pretrained/NAME (aerial-gym list
    pretrained)."""

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
        rows = list[Sequence[object]]()
        try:
            self._fly_or_replay(rows)
        finally:
            if self.out is self.video is self.record is None and rows:
                csv.writer(sys.stdout, lineterminator="\n").writerows(rows)
        return 0

    def result(self) -> FlightTable:
        """Return the flights, and write the files."""
        rows = list[Sequence[object]]()
        self._fly_or_replay(rows)
        columns = [str(name) for name in rows[0]]
        return FlightTable(columns=columns, rows=rows[1:], num_envs=self.num_envs if self.replay is None else None)

    def _fly_or_replay(self, rows: list[Sequence[object]]) -> None:
        """Append the names of the columns and the rows, and write the files."""
        if (self.policy is None) == (self.replay is None):
            raise ConfigError("play: give exactly one of --policy and --replay")
        if self.replay is not None:
            self._read_non_finite_steps(self.replay, rows)
        else:
            self._fly_policy(rows)

    def _fly_policy(self, rows: list[Sequence[object]]) -> None:
        """Fly the policy, and write the files, also of flights that are interrupted."""
        assert self.policy is not None
        views = self._check_outputs()
        from aerial_gym.config.changes import settings_of_run
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
            task.require_one_vehicle("play")
            check_fits(policy, task, cfg.task)
            rows.append(COLUMNS)
            observers = list[Callable[["Tensor"], None]]()
            if self.out is not None:
                stack.callback(self._write_rows, self.out, rows)
            if self.video is not None:
                from aerial_gym.cli.film import Film

                film = Film(task, views)
                stack.callback(film.save, self.video)
                observers.append(film.render_frame)
            if self.record is not None:
                from aerial_gym.cli.record import FlightRecorder

                recorder = FlightRecorder(task, self.record)
                stack.callback(recorder.close)
                observers.append(recorder.write_step)
            _fly(policy, task, self.num_steps, rows, observers)

    def _check_outputs(self) -> int:
        """Return the number of environments in the film; raise an error if it, or a file, is impossible."""
        from aerial_gym.cli.film import MOST_VIEWS, check_film

        views = min(MOST_VIEWS, self.num_envs) if self.video_envs is None else self.video_envs
        if not 1 <= views <= self.num_envs:
            raise ConfigError(f"--video-envs {views}: must be 1 to {self.num_envs}, the value of --num-envs")
        if self.video is not None:
            check_film(self.video)
        if self.record is not None:
            if self.record.suffix != ".mcap":
                raise ConfigError(f"--record {self.record}: must end in .mcap")
            require("--record", "mcap", "scipy", "pandas")
        return views

    def _read_non_finite_steps(self, dump: Path, rows: list[Sequence[object]]) -> None:
        """Print which numbers of each row were NaN or infinite on stderr, and append the last steps of the row."""
        from aerial_gym.robots.finite_watch import read_dump

        table, sentences = read_dump(dump)
        for sentence in sentences:
            print(sentence, file=sys.stderr)
        rows += table
        if self.out is not None:
            self._write_rows(self.out, rows)

    @staticmethod
    def _write_rows(file: Path, rows: Sequence[Sequence[object]]) -> None:
        with storage_errors(file, only_full=True), file.open("w", encoding="utf-8", newline="") as out:
            csv.writer(out).writerows(rows)


def _fly(
    policy, task, num_steps: int, rows: list[Sequence[object]], observers: Sequence[Callable[["Tensor"], None]]
) -> None:
    """Fly, append the rows of ``COLUMNS``, one for each step and environment, and show each step to the observers.

    An observer receives which environments begin an episode, bool (E,).
    """
    import torch

    gtd, begins = task.env.gtd, torch.ones(task.num_envs, dtype=torch.bool)
    with torch.no_grad():
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
