"""``aerial-gym train``: a policy from scratch, or on from where a run stopped."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from aerial_gym.cli.process import start_time
from aerial_gym.config.set_option import SetOption
from aerial_gym.errors import ConfigError
from aerial_gym.interop.preload import import_without_torch
from aerial_gym.lazy import pause_garbage_collection

if TYPE_CHECKING:
    from aerial_gym.rl_training.run.progress import TrainingObserver
    from aerial_gym.rl_training.settings import TrainingCfg
    from aerial_gym.rl_training.training import TrainingResult

CONSTANTS = ("num_envs", "seed", "robot", "controller", "backend", "encoder")  # Settings that a resumed training keeps
LIMITS = ("max_time_s", "max_env_steps")  # Limits of a training; those of the command line replace both


@dataclass(frozen=True, kw_only=True)
class TrainCmd:
    """Train a policy with a learner of this package or of another library."""

    task: str | None = field(default=None, kw_only=False)
    """Registered task, a task file (.yaml), a level of lsy_drone_racing (.toml), or
    module:Name or file.py:Name of a TaskCfg or a Task of your own; position_setpoint_task if not given."""

    trainer: str | None = None  # Registered trainer (aerial-gym list trainers); ppo if not given
    teacher: Path | None = None  # Policy that distill hands on: a run folder, one checkpoint in it, or pretrained/NAME

    initial: Path | None = None
    """Run folder, one checkpoint in it, or pretrained/NAME: a training with ppo with whose networks this one begins;
    observations of the task begin with those of that one's."""

    out: Path = Path("runs/train")  # Run folder: settings, checkpoints, TensorBoard files. New, unless --resume
    resume: bool = False  # Continue the run in --out from its last checkpoint; only the limits given here change

    for_real: str | None = None
    """Registered robot or robot file of a real vehicle: trains within what --log leaves uncertain, exports, and runs
    robustness. The same command continues after an interruption."""

    log: Path | None = None  # Log of that vehicle, as of preflight; a robot.yaml of close-loop beside it is used
    preflight: Path | None = None  # Result of aerial-gym preflight --out, in place of --log
    mapping: str | None = None  # Mapping of a CSV file for --log: a name or a file (.yaml)

    config: Path | None = None
    """Settings in a YAML file. One that leaves out required fields extends the package's own for its task and trainer."""

    set: SetOption = ()
    """Setting in place of the file's, such as ppo.learning_rate=1e-3, or of task, robot, env or sim, such as
    robot.body.mass=0.3; can be repeated. The reference of training, task and robot files lists the keys."""

    num_envs: int | None = None  # Environments side by side; where torchrun starts several processes, in each of them
    device: str | None = None  # Torch device; auto takes the GPU if there is one
    seed: int | None = None  # Seed of task and trainer
    robot: str | None = None  # Registered robot, or a robot file such as close-loop writes, in place of the task's own
    controller: str | None = None  # Registered controller in place of the task's own
    backend: str | None = None  # Registered physics backend (aerial-gym list backends); that of the sim if not given

    encoder: str | None = None
    """Encoder file of train-encoder, or one that comes with the package, in place of the task's own: navigation then sees its
    latents in place of the nearest distances in 64 cells."""

    max_time_s: float | None = None
    """End after this time, start-up included [s]. This or max_env_steps alone drops the other limit of the settings."""

    max_env_steps: int | None = None  # End after this many environment steps of all sessions and processes together

    watch: bool = False
    """Keep the last 64 steps of rows that are NaN or infinite, and write them to non_finite.csv in --out; play --replay
    shows it."""

    view: bool = False  # Show one environment in the browser (127.0.0.1, --port)
    port: int = 8080  # Port of the page of --view
    wandb: str | None = None  # Project of Weights & Biases; WANDB_MODE=offline keeps its data in --out
    json: bool = False  # Print the result as one JSON object

    def run(self) -> int:
        """Train and print where the policy lies; return the exit status, 1 if it was interrupted."""
        from aerial_gym.rl_training.ranks import torchrun_rank

        if self.for_real is not None:
            from aerial_gym.cli.train_for_real import print_record, train_for_real

            return print_record(self, train_for_real(self))
        result = self.result()
        if torchrun_rank() == 0:
            self._print_result(result)
        return 1 if result.interrupted else 0

    def result(self) -> "TrainingResult":
        """Train."""
        with pause_garbage_collection():
            import_without_torch()
            from aerial_gym.config.changes import Changes, changes_simulation
            from aerial_gym.rl_training.policies.catalog import policy_path
            from aerial_gym.rl_training.run.run_folder import RunFolder
            from aerial_gym.rl_training.settings import load_task_settings
            from aerial_gym.rl_training.training import TrainingResult, train
            from aerial_gym.task import task_registry

        if self.for_real is not None:
            from aerial_gym.cli.train_for_real import train_for_real

            return TrainingResult(**train_for_real(self)["training"])
        for name in ("log", "preflight", "mapping"):
            if getattr(self, name) is not None:
                raise ConfigError(f"--{name}: needs --for-real ROBOT")
        if self.resume:
            cfg = RunFolder(self.out).config()
            self._refuse_changes(cfg)
        else:
            cfg = load_task_settings(self.config, trainer=self.trainer, task=self.task, device=self.device or "auto")
            cfg = replace(cfg, task=task_name_with_absolute_path(cfg.task))
        names = (*CONSTANTS, "device", *LIMITS)
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if given.keys() & set(LIMITS):
            given = dict.fromkeys(LIMITS) | given
        for name, run in (("teacher", self.teacher), ("initial", self.initial)):
            if run is not None:
                given[name] = str(policy_path(run).resolve())
        changes = Changes(self.set)
        cfg = changes.apply("", replace(cfg, **given))
        names = {"num_envs": cfg.num_envs, "robot": cfg.robot, "controller": cfg.controller}
        task_registry.configurations(cfg.task, changes, **names)
        changes.finish()
        cfg = replace(cfg, settings=(*cfg.settings, *filter(changes_simulation, self.set)))
        more = {"resume": self.resume, "watch": self.watch, "wandb": self.wandb, "started": start_time()}
        with self._make_observer() as observer:
            return train(cfg, self.out, observer=observer, **more)

    @contextmanager
    def _make_observer(self) -> "Iterator[TrainingObserver | None]":
        """Yield the page of ``--view``, in the first process; None without it."""
        from aerial_gym.rl_training.ranks import torchrun_rank

        if not self.view or torchrun_rank() != 0:
            yield None
            return
        from aerial_gym.viewer.observer import TrainingView

        page = TrainingView(port=self.port)
        print(f"http://127.0.0.1:{self.port} shows one environment", file=sys.stderr)
        try:
            yield page
        finally:
            page.close()

    def _print_result(self, result: "TrainingResult") -> None:
        if self.json:
            print(json.dumps(asdict(result)))
        else:
            console = Console(markup=False, highlight=False)
            rate = f"{result.env_steps:,} environment steps, {result.env_steps_per_s:,.0f} per second"
            console.print(f"{'interrupted' if result.interrupted else 'trained'}: {rate}, {result.time_s:.0f} s")
            if result.non_finite:
                watched, log = f"play --replay {self.out}/non_finite.csv", f"{self.out}/log.txt, or train --watch"
                rows = f"{result.non_finite:,} rows were NaN or infinite and ended as crashes"
                console.print(f"{rows}: see {watched if self.watch else log}")
            console.print(f"checkpoint: {result.checkpoint or 'none yet'}")
            if any(self.out.rglob("events.out.tfevents.*")):
                console.print(f"curves: tensorboard --logdir {self.out}", soft_wrap=True)
            again = f"train --out {self.out} --resume" if result.interrupted else f"evaluate --policy {self.out}"
            console.print(f"next: aerial-gym {again}")

    def _refuse_changes(self, cfg: "TrainingCfg") -> None:
        for flag, given, own in (
            ("task", None if self.task is None else task_name_with_absolute_path(self.task), cfg.task),
            ("trainer", self.trainer, cfg.trainer),
        ):
            if given not in (None, own):
                raise ConfigError(
                    f"--{flag} {given}: the run in {self.out} is of {own}. Leave it out, or start a new run in another --out"
                )
        for name in ("config", "teacher", "initial", *CONSTANTS):
            if getattr(self, name) is not None:
                flag = name.replace("_", "-")
                raise ConfigError(f"--{flag}: a resumed run keeps its own. Leave it out, or begin in another --out")
        if self.set:
            raise ConfigError("--set: a resumed run keeps its own settings. Leave it out, or begin in another --out")


def task_name_with_absolute_path(task: str) -> str:
    """Return a task's name, with an absolute path for a file."""
    file, colon, name = task.rpartition(":")
    if file.endswith(".py"):
        return f"{Path(file).resolve()}{colon}{name}"
    return str(Path(task).resolve()) if task.endswith((".yaml", ".yml", ".toml")) else task
