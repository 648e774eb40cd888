"""Train a policy with any trainer into a run folder, and restore the global settings of the libraries afterwards."""

import contextlib
import json
import logging
import random
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from aerial_gym.config.changes import Changes
from aerial_gym.config.storage import storage_errors, write_atomic
from aerial_gym.errors import AerialGymError, ConfigError, StorageError, TrainingError
from aerial_gym.interop import on_device, resolve_device, usual_settings
from aerial_gym.physics import BACKENDS
from aerial_gym.rl_training.policies.load import find_checkpoint
from aerial_gym.rl_training.ranks import Ranks, join_ranks, process_device
from aerial_gym.rl_training.run.checkpoint_keeper import CheckpointKeeper, Interruption, checkpoint_steps, interruptible
from aerial_gym.rl_training.run.progress import Progress, TrainingObserver
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.run.training_run import TrainingRun
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.catalog import TRAINERS, trainers_with_feature
from aerial_gym.rl_training.trainers.summaries import require_wandb, send_scalars, warn_without_tensorboard
from aerial_gym.sensors.encoder.file import load_encoder
from aerial_gym.task import task_registry

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class TrainingResult:
    """Result of one session of training."""

    trainer: str  # Name of the trainer
    checkpoint: str | None  # The last checkpoint; None if the user ended it before the first
    env_steps: int  # Environment steps in all sessions
    time_s: float  # Length of this session, start-up included [s]
    env_steps_per_s: float  # Environment steps per second of this session, learning included, start-up not
    episode_return: float | None  # Mean return of the last episodes, with exploration
    episode_length: float | None  # Mean length of the last episodes [steps]
    interrupted: bool  # Whether the user ended it
    non_finite: int = 0  # Number of NaN or infinite rows in this session; each ended its episode

    def __repr__(self) -> str:
        steps = f"{self.env_steps:,} environment steps, {self.env_steps_per_s:,.0f} per second"
        gained = "" if self.episode_return is None else f"; return {self.episode_return:.4g}"
        ended = "; interrupted" if self.interrupted else ""
        file = self.checkpoint or "no checkpoint"
        return f"TrainingResult: {self.trainer}, {steps}, {self.time_s:.0f} s{gained}{ended}; {file}"


@usual_settings
def train(
    cfg: TrainingCfg, out: str | Path, *, resume: bool = False, show_progress: bool = True, watch: bool = False,
    wandb: str | None = None, started: float | None = None, observer: TrainingObserver | None = None,
) -> TrainingResult:  # fmt: skip
    """Train a policy into a run folder. The global random generators are seeded meanwhile.

    Args:
        cfg: Settings; of a resumed run the limits may differ from those of the first session.
        out: Run folder, new unless ``resume``.
        resume: Whether to continue from the folder's last checkpoint; a run without one starts again.
        show_progress: Whether to draw a bar on stderr.
        watch: Whether to write the last steps of rows that were not finite to ``non_finite.csv``.
        wandb: Project of Weights & Biases that receives the scalars.
        started: Reading of ``time.perf_counter`` at which ``max_time_s`` begins to count [s]; this call's start if not given.
        observer: Watches the task, such as a page that shows it; in rank 0 only.

    Raises:
        ConfigError: If the folder holds a run and ``resume`` is off, or no checkpoint of it can be read.
        UnknownNameError: If the task is not registered.
        MissingDependencyError: If the trainer's package is not installed.
        StorageError: If the disk is full.
    """
    started = time.perf_counter() if started is None else started
    _check_names(cfg, resume=resume)
    TRAINERS.get(cfg.trainer).require()
    warn_without_tensorboard()
    if wandb is not None:
        require_wandb()
    with join_ranks(cfg.device) as ranks, _leader_or_temporary_folder(ranks, out) as folder:
        if ranks.size > 1 and not TRAINERS.get(cfg.trainer).several_processes:
            raise ConfigError(
                f"trainer {cfg.trainer} learns in one process, and {ranks.size} were started. Leave torchrun out, or use "
                f"--trainer {trainers_with_feature('several_processes')}"
            )
        with contextlib.nullcontext() if resume else _new_run_folder(cfg, folder, ranks):
            return _train_session(
                cfg, folder, ranks, started=started, resume=resume, show_progress=show_progress, watch=watch,
                wandb=wandb, observer=observer if ranks.is_leader else None,
            )  # fmt: skip


@contextlib.contextmanager
def _new_run_folder(cfg: TrainingCfg, folder: RunFolder, ranks: Ranks) -> Iterator[None]:
    """Make the folder of a new run, and remove it if the request is refused before the first session."""
    folder.create(cfg)
    try:
        yield
    except (StorageError, TrainingError):
        raise
    except AerialGymError:
        if ranks.is_leader:
            folder.discard_unstarted()
        raise


@contextlib.contextmanager
def _leader_or_temporary_folder(ranks: Ranks, out: str | Path) -> Iterator[RunFolder]:
    """Yield the run folder in rank 0, and a temporary one in other processes."""
    if ranks.is_leader:
        yield RunFolder(out)
        return
    with tempfile.TemporaryDirectory(prefix=f"aerial_gym_rank_{ranks.rank}_") as folder:
        yield RunFolder(folder)


def _train_session(
    cfg: TrainingCfg, folder: RunFolder, ranks: Ranks, *, started: float, resume: bool, show_progress: bool,
    watch: bool, wandb: str | None, observer: TrainingObserver | None,
) -> TrainingResult:  # fmt: skip
    resumed = ranks.broadcast(folder.newest_readable_checkpoint() if resume and ranks.is_leader else None)
    if resume and resumed is None and ranks.is_leader:
        _log.warning("%s: ended before its first checkpoint; the training starts anew in the same folder", folder.path)
    steps = checkpoint_steps(resumed, cfg.trainer)
    shown = show_progress and ranks.is_leader
    with (
        storage_errors(folder.path, only_full=True),
        _restore_globals(cfg),
        interruptible(ranks) as interruption,
        Progress(
            cfg, folder.curve_file, started=started, show=shown, resumed_steps=steps, ranks=ranks, observer=observer
        ) as progress,
        folder.redirect_output(),
        contextlib.nullcontext() if wandb is None or not ranks.is_leader else send_scalars(wandb, folder, cfg),
    ):
        try:
            interrupted = _run_trainer(
                cfg, folder, progress, resumed, interruption, ranks, watch=watch, observer=observer
            )
        except KeyboardInterrupt:
            interrupted = True
    last, checkpoints = progress.last, folder.checkpoints()
    result = TrainingResult(
        trainer=cfg.trainer, checkpoint=str(checkpoints[-1]) if checkpoints else None,
        env_steps=max(progress.env_steps, steps), time_s=progress.session_time_s(),
        env_steps_per_s=progress.steps_per_s, episode_return=last.episode_return if last else None,
        episode_length=last.episode_length if last else None, interrupted=interrupted, non_finite=progress.non_finite,
    )  # fmt: skip
    write_atomic(folder.result_file, json.dumps(asdict(result), indent=1) + "\n")
    return result


def _check_names(cfg: TrainingCfg, *, resume: bool) -> None:
    """Raise an error for an unknown name or an unreadable file before anything is written."""
    changes = Changes(cfg.settings)
    task_registry.configurations(cfg.task, changes, num_envs=cfg.num_envs, robot=cfg.robot, controller=cfg.controller)
    changes.finish()
    TRAINERS.get(cfg.trainer).check(cfg)
    if cfg.initial is not None and not resume:
        find_checkpoint(cfg.initial)
    if cfg.encoder is not None:
        load_encoder(cfg.encoder)
    if cfg.backend not in (None, "auto"):
        BACKENDS.get(cfg.backend)


def _run_trainer(
    cfg: TrainingCfg, folder: RunFolder, progress: Progress, resumed: tuple[Path, dict[str, Any]] | None,
    interruption: Interruption, ranks: Ranks, *, watch: bool, observer: TrainingObserver | None,
) -> bool:  # fmt: skip
    trainer = TRAINERS.get(cfg.trainer)
    trainer.prepare(resolve_device(process_device(cfg.device)))
    interruption.check()  # an import may have swallowed it
    seed = (cfg.seed + ranks.rank) % 2**32
    torch.manual_seed(seed)
    np.random.seed(seed)
    random.seed(seed)
    made = task_registry.make_task(
        cfg.task, num_envs=cfg.num_envs, device=process_device(cfg.device), seed=cfg.seed,
        first_env=ranks.rank * cfg.num_envs, robot=cfg.robot, controller=cfg.controller, backend=cfg.backend,
        encoder=cfg.encoder, settings=cfg.settings, capture=trainer.captures_task, differentiable=trainer.differentiable,
    )  # fmt: skip
    with made as task, on_device(task.device), contextlib.nullcontext() if observer is None else observer.follow(task):
        interruption.check()
        task.practise()
        folder.add_session(cfg, str(task.device))
        keeper = CheckpointKeeper(cfg, folder, task, resumed=resumed, ranks=ranks)
        if watch:
            task.watch()
        interrupted = trainer.run(TrainingRun(cfg, task, folder, progress, keeper, interruption, ranks))
        non_finite = torch.tensor(task.num_non_finite)
        progress.non_finite = int(ranks.sum_(non_finite))
        if watch and progress.non_finite:
            task.dump(folder.path / "non_finite.csv")
        return interrupted


@contextlib.contextmanager
def _restore_globals(cfg: TrainingCfg) -> Iterator[None]:
    """Set the threads of torch, and restore the global settings that the libraries change."""
    threads, precision = torch.get_num_threads(), torch.get_float32_matmul_precision()
    cudnn = torch.backends.cudnn.benchmark, torch.backends.cudnn.allow_tf32, torch.backends.cuda.matmul.allow_tf32
    sharing, numpy_state, python_state = (
        torch.multiprocessing.get_sharing_strategy(), np.random.get_state(), random.getstate(),
    )  # fmt: skip
    devices = range(torch.cuda.device_count()) if torch.cuda.is_available() else ()
    if cfg.torch_threads is not None:
        torch.set_num_threads(cfg.torch_threads)
    try:
        with torch.random.fork_rng(devices=list(devices)):
            yield
    finally:
        torch.set_num_threads(threads)
        torch.set_float32_matmul_precision(precision)
        torch.backends.cudnn.benchmark, torch.backends.cudnn.allow_tf32, torch.backends.cuda.matmul.allow_tf32 = cudnn
        torch.multiprocessing.set_sharing_strategy(sharing)
        np.random.set_state(numpy_state)
        random.setstate(python_state)
        torch.set_printoptions(profile="default")
