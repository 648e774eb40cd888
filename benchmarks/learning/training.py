"""Training time to a good policy: ``python -m benchmarks.learning.training --device cuda --json``.

Trains with a learner of this package, stops the clock from time to time, and flies the policy from fresh starts. ``training_s``
counts iterations: the first few, in which kernels are compiled and the graph is recorded (``recording_s``), as long as those
that follow them. ``since_process_start_s`` is all but the evaluations: imports, the task, compilation, recording, training.
"""

import contextlib
import csv
import json
import platform
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from aerial_gym.rl_training.learning.apg import Apg
    from aerial_gym.rl_training.learning.ppo import Ppo
    from aerial_gym.rl_training.run.progress import Report
    from aerial_gym.rl_training.settings import TrainingCfg
    from aerial_gym.rl_training.trainers.native import NativeTraining

STARTED = time.perf_counter()


@dataclass(frozen=True, kw_only=True)
class BenchTraining:
    """One training from scratch."""

    task: str = "position_setpoint_task"  # Registered task
    trainer: str = "ppo"  # ``ppo`` or ``apg``

    robot: str | None = None
    """Registered robot, or a robot file, to train with; that of the settings if not given. The task's own is evaluated."""

    level: int | None = None
    """Level of the task's curriculum at which the policy is evaluated; its highest if not given."""

    device: str = "auto"  # Torch device
    seed: int = 1  # Of the training; starts of the evaluation have another
    seeds: tuple[int, ...] = ()  # Several trainings, each in a process of its own, and median and worst of them
    num_envs: int | None = None  # Environments; that of the settings if not given
    config: str | None = None  # Settings file; that of the package if not given
    set: tuple[str, ...] = ()  # Numbers of the learner in place of those of the settings, as NAME=VALUE
    train_s: float = 5.0  # Length of the training [s]: the learning rate falls over it
    every_s: float = 0.5  # Training between two evaluations [s]
    num_starts: int = 1000  # Fresh episodes of an evaluation
    threads: int | None = None  # Threads of torch on a CPU

    processor_time: bool = False
    """Count the processor time of this process in place of the time on the wall: for a busy machine, with one thread."""

    plain: bool = False  # On a GPU, networks of ``ppo`` as torch operations in place of kernels of their own
    json: bool = False  # One object a line, keys end in their unit

    out: Path | None = None
    """New run folder for the policy at the end and the learning curve; of several seeds, one each in it."""

    def run(self) -> int:
        """Train, evaluate, print; return the exit status."""
        return self._run_seeds() if self.seeds else self._run_once()

    def _run_seeds(self) -> int:
        """Run one process a seed, pass on what it prints, and print what they have in common."""
        marks: dict[float, list[dict[str, float]]] = {}
        for seed in self.seeds:
            given = [item for item in sys.argv[1:] if item != "--json"]
            place = given.index("--seeds")
            given = given[:place] + given[place + 1 + len(self.seeds) :]
            if self.out is not None:
                given[given.index("--out") + 1] = str(self.out / str(seed))
            command = [sys.executable, "-m", "benchmarks.learning.training", *given, "--seed", str(seed), "--json"]
            out = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
            print(out, end="", flush=True)
            *rows, _ = (json.loads(line) for line in out.splitlines())
            for number, row in enumerate(rows, start=1):
                marks.setdefault(round(number * self.every_s, 6), []).append(row)
        for mark, rows in marks.items():
            errors = [inf if row["final_error_mean_m"] is None else row["final_error_mean_m"] for row in rows]
            since = [row["since_process_start_s"] for row in rows]
            success = [row["success_rate"] for row in rows]
            self._print_row(
                {
                    "training_s": mark, "seeds": len(rows), "final_error_median_m": median(errors),
                    "final_error_worst_m": max(errors), "success_rate_median": median(success),
                    "success_rate_worst": min(success), "crash_rate_worst": max(row["crash_rate"] for row in rows),
                    "since_process_start_median_s": median(since), "since_process_start_worst_s": max(since),
                }
            )  # fmt: skip
        return 0

    def _run_once(self) -> int:
        """Train once."""
        import torch

        from aerial_gym.rl_training import TRAINERS, evaluate
        from aerial_gym.rl_training.trainers.trainer import NativeTrainer
        from aerial_gym.task import task_registry

        if self.threads is not None:
            torch.set_num_threads(self.threads)
        cfg, trainer, make = self._settings(), TRAINERS.get(self.trainer), task_registry.make_task
        with contextlib.ExitStack() as stack:
            options = {"robot": cfg.robot, "capture": False, "differentiable": trainer.differentiable}
            task = make(cfg.task, num_envs=cfg.num_envs, device=cfg.device, seed=cfg.seed, **options)
            stack.enter_context(task)
            task.practise()
            curriculum = task.cfg.curriculum
            level = curriculum.max_level if self.level is None and curriculum is not None else self.level
            cuda = task.device.type == "cuda"
            wait = torch.cuda.synchronize if cuda else (lambda: None)
            clock = time.process_time if self.processor_time else time.perf_counter
            plain: dict[str, Any] = {"fused": False} if self.plain else {}
            assert isinstance(trainer, NativeTrainer)
            training = trainer.make_training(cfg, task, **plain)
            trained_s, evaluated_s, iteration_s, fresh = 0.0, 0.0, 0.0, None
            started_s = time.perf_counter() - STARTED
            begun = clock()
            reports = [training.advance()]
            wait()
            recording_s, warm = clock() - begun, training.iterations
            while trained_s < self.train_s:
                due = min(trained_s + self.every_s, self.train_s)
                while trained_s < due:
                    training.learner.time_share.fill_(trained_s / self.train_s)
                    wait()
                    begun, before = clock(), training.iterations
                    reports.append(training.advance())
                    wait()
                    spent = clock() - begun
                    trained_s += spent if iteration_s else spent * training.iterations / (training.iterations - before)
                    iteration_s = spent / (training.iterations - before)
                begun = time.perf_counter()
                since = begun - STARTED - evaluated_s
                if fresh is None:
                    options = {"seed": 1_000_003 + cfg.seed, "level": level}
                    fresh = make(cfg.task, num_envs=self.num_starts, device=cfg.device, **options)
                    stack.enter_context(fresh)
                result = evaluate(training.learner.network.actor, fresh)
                wait()
                evaluated_s += time.perf_counter() - begun
                figures = ("final_error_mean_m", "final_error_p95_m", "success_rate", "crash_rate")
                progress = {"training_s": trained_s, "since_process_start_s": since, "env_steps": training.env_steps}
                self._print_row(progress | {name: getattr(result, name) for name in figures} | training.gauges())
            if self.out is not None:
                write_run_folder(self.out, cfg, training, reports)
            wait()
            begun, first = clock(), training.env_steps
            for _ in range(4):
                training.advance()
            wait()
            self._print_row(
                {
                    "steps_per_s": (training.env_steps - first) / (clock() - begun), "before_training_s": started_s,
                    "recording_s": max(recording_s - warm * iteration_s, 0.0), "iteration_s": iteration_s,
                    "num_envs": cfg.num_envs, "horizon": cfg.learner.horizon,
                    "learner": type(training.learner).__name__, "seed": cfg.seed,
                    "device": torch.cuda.get_device_name() if cuda else platform.processor() or platform.machine(),
                    "torch": torch.__version__,
                }
            )  # fmt: skip
        return 0

    def _settings(self) -> "TrainingCfg":
        from aerial_gym.rl_training import load_settings, settings_for

        cfg = load_settings(self.config or settings_for(self.trainer, self.task, device=self.device))
        changes = {name: json.loads(value) for name, value in (entry.split("=", 1) for entry in self.set)}
        changes = {name: tuple(value) if isinstance(value, list) else value for name, value in changes.items()}
        own = {"task": self.task, "seed": self.seed, "device": self.device, "max_time_s": self.train_s}
        given = {name: value for name in ("robot", "num_envs") if (value := getattr(self, name))}
        return replace(cfg, **own, **given, **{self.trainer: replace(cfg.learner, **changes)})

    def _print_row(self, row: Mapping[str, object]) -> None:
        texts = (f"{key} {value:,.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items())
        print(json.dumps(row) if self.json else "  ".join(texts), flush=True)


def write_run_folder(
    out: Path, cfg: "TrainingCfg", training: "NativeTraining[Ppo] | NativeTraining[Apg]", reports: Sequence["Report"]
) -> None:
    """Write the policy and the learning curve as a run folder, which cannot be resumed."""
    from aerial_gym.rl_training.run.run_folder import RunFolder, append_session

    folder, state = RunFolder(out), training.state()
    folder.create(cfg)
    append_session(out, seed=cfg.seed, device=str(training.task.device))
    folder.write_checkpoint(training.env_steps, {name: state[name] for name in ("model", "network", "env_steps")})
    with folder.curve_file.open("w", encoding="utf-8", newline="") as file:
        rows = ((report.env_steps, report.episode_return, report.episode_length) for report in reports)
        csv.writer(file).writerows([("env_steps", "episode_return", "episode_length"), *rows])


if __name__ == "__main__":
    import tyro

    sys.exit(tyro.cli(BenchTraining).run())
