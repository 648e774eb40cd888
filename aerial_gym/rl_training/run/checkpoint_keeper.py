"""Checkpoints of a training: content, schedule and resumption, common to all trainers."""

import logging
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch

from aerial_gym.config import to_mapping
from aerial_gym.errors import ConfigError, TrainingError
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Whether somebody asked the training to end. A library may swallow the exception; this is remembered.

    All processes end together at a common check: one that ended alone would leave the others waiting.
    """

    def __init__(self, ranks: Ranks = ALONE) -> None:
        self.asked, self._waits, self._ranks = False, False, ranks

    @contextmanager
    def defer(self) -> Iterator[None]:
        """Defer an interruption until the block has ended, then raise it."""
        self._waits = True
        try:
            yield
        finally:
            self._waits = False
        self.check()

    def check(self) -> None:
        """Raise ``KeyboardInterrupt`` if any process got a signal; all processes must call this."""
        self.asked = self._ranks.any(self.asked)
        if self.asked:
            raise KeyboardInterrupt

    def _note_signal(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if not (self._waits or self._ranks.joined):
            raise KeyboardInterrupt


@contextmanager
def interruptible(ranks: Ranks = ALONE) -> Iterator[Interruption]:
    """Yield an ``Interruption`` that both signals set, then restore the handlers; only the main thread gets signals."""
    interruption = Interruption(ranks)
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    kept = {number: signal.signal(number, interruption._note_signal) for number in SIGNALS}
    try:
        yield interruption
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


FIRST_INTERVAL_S = 5.0  # Longest time to the first checkpoint [s], or to the first update if that takes longer
_log = logging.getLogger(__name__)


class CheckpointKeeper:
    """Writes checkpoints: the trainer's state, and beside it settings, curriculum and random states.

    With several processes all save together, and rank 0 writes its state and the keys that differ in the others.
    """

    def __init__(
        self, cfg: TrainingCfg, folder: RunFolder, task: Task, *, resumed: tuple[Path, dict[str, Any]] | None,
        ranks: Ranks = ALONE,
    ) -> None:  # fmt: skip
        self._cfg, self._folder, self._task, self._resumed, self._ranks = cfg, folder, task, resumed, ranks
        self.ready = resumed is None  # Whether there is a state to save: not before a resumed state is restored
        self._saved_at, self._interval = time.perf_counter(), min(FIRST_INTERVAL_S, cfg.checkpoint_every_s)

    @property
    def resumes(self) -> bool:
        """Whether there is a checkpoint to resume from."""
        return self._resumed is not None

    @property
    def due(self) -> bool:
        """Whether a checkpoint is due, by the clock of rank 0."""
        return self._ranks.broadcast_number(time.perf_counter() - self._saved_at) >= self._interval

    def save(self, state: Mapping[str, object], *, env_steps: int, own: Sequence[str] = ()) -> None:
        """Write a trainer's state, by name, after ``env_steps`` of all sessions; keys of ``own`` differ between processes."""
        self._check_weights(state)
        run, first = self._run_state(env_steps), env_steps == 0
        rank_states = self._ranks.gather({name: state[name] for name in own} | {"task_random": run["task_random"]})
        if self._ranks.is_leader:
            self._folder.write_checkpoint(env_steps, {**state, "run": run, "others": rank_states})
        self._saved_at = time.perf_counter()
        self._interval = min(FIRST_INTERVAL_S, self._cfg.checkpoint_every_s) if first else self._cfg.checkpoint_every_s

    def _check_weights(self, state: Mapping[str, Any]) -> None:
        networks = [state, *(part for part in state.values() if isinstance(part, Mapping) and "model" in part)]
        weights = [entry for each in networks for entry in each.get("model", {}).items()]
        bad = [name for name, tensor in weights if not bool(tensor.isfinite().all())]
        if bad:
            known = self._folder.checkpoints()
            left = f"The last checkpoint before that is {known[-1]}" if known else "There is no checkpoint before that"
            raise TrainingError(f"the training diverged: {bad[0]} is NaN or infinite. {left}")

    def restore(self, load: Callable[[dict[str, Any]], None], *, own: Sequence[str] = ()) -> None:
        """Hand the checkpoint to the trainer's ``load``, then take up curriculum and random states. Keys that differ between
        processes (``own``) are missing for a rank new to the run."""
        assert self._resumed is not None
        path, payload = self._resumed
        try:
            payload = self._payload_for_rank(payload, path, own)
            load(payload)
            self._restore_run(payload.get("run", {}))
            self.ready = True
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError, IndexError) as error:
            _log.exception("%s: cannot be taken up", path)
            raise ConfigError(
                f"checkpoint {path}: does not fit the settings of its run ({type(error).__name__}; the log of the run says "
                "more). Start a new run in another --out"
            ) from None

    def _payload_for_rank(self, payload: dict[str, Any], path: Path, own: Sequence[str]) -> dict[str, Any]:
        """Return the part of a checkpoint that belongs to this process; a new rank gets the shared part alone."""
        rank_states, ranks = payload.get("others", []), self._ranks
        if len(rank_states) + 1 != ranks.size and ranks.is_leader:
            _log.warning(
                "%s: of %d processes, continues with %d: all have the learned networks; simulations continue in the former "
                "processes and restart in others", path, len(rank_states) + 1, ranks.size
            )  # fmt: skip
        if ranks.is_leader:
            return payload
        own_state = dict(rank_states[ranks.rank - 1]) if ranks.rank <= len(rank_states) else {}
        run = payload.get("run", {}) | {"task_random": own_state.pop("task_random", None)}
        return {name: value for name, value in payload.items() if name not in own} | own_state | {"run": run}

    def _run_state(self, env_steps: int) -> dict[str, object]:
        curriculum = self._task.curriculum
        return {
            "trainer": self._cfg.trainer, "env_steps": env_steps, "settings": to_mapping(self._cfg),
            "curriculum": None if curriculum is None else curriculum.state(), "random": random_state(),
            "task_random": {name: tensor.clone() for name, tensor in self._task.random_tensors().items()},
        }  # fmt: skip

    def _restore_run(self, state: dict[str, Any]) -> None:
        curriculum = self._task.curriculum
        if curriculum is not None and state.get("curriculum") is not None:
            curriculum.load(state["curriculum"])
        if "random" in state:
            restore_random_state(state["random"])
        if state.get("task_random") is not None:
            for name, tensor in self._task.random_tensors().items():
                tensor.copy_(state["task_random"][name])


def checkpoint_steps(resumed: tuple[Path, dict[str, Any]] | None, trainer: str) -> int:
    """Return the environment steps of a checkpoint; 0 without one."""
    if resumed is None:
        return 0
    path, payload = resumed
    source_trainer = payload.get("run", {}).get("trainer", trainer)
    steps = payload.get("run", payload).get("env_steps", payload.get("frame"))
    if source_trainer != trainer or not isinstance(steps, int):
        raise ConfigError(f"checkpoint {path}: is not one of a {trainer} training")
    return steps


def random_state() -> dict[str, object]:
    """Return the states of the global generators of torch, CUDA, NumPy and Python, ready for a checkpoint."""
    kind, keys, position, has_gauss, cached = np.random.get_state()
    return {
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "numpy": [str(kind), torch.from_numpy(np.asarray(keys).astype(np.int64)), position, has_gauss, cached],
        "python": random.getstate(),
    }


def restore_random_state(state: Mapping[str, Any]) -> None:
    """Continue the global generators where ``random_state`` found them; GPUs only on a machine with as many."""
    torch.set_rng_state(state["torch"])
    if state["cuda"] and torch.cuda.is_available() and len(state["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all(state["cuda"])
    kind, keys, position, has_gauss, cached = state["numpy"]
    np.random.set_state((kind, keys.numpy().astype(np.uint32), position, has_gauss, cached))
    version, words, gauss = state["python"]
    random.setstate((version, tuple(words), gauss))
