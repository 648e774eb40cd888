"""TensorBoard writers whose thread outlives a full disk, and copies of their scalars to Weights & Biases.

``tensorboardX`` writes in a thread behind a queue of ten events. An error of writing ends that thread and nothing else: the
queue fills, and the training waits in it for ever.
"""

import importlib.util
import json
import logging
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aerial_gym.config import to_mapping
from aerial_gym.config.storage import storage_message, write_atomic
from aerial_gym.errors import MissingDependencyError, StorageError
from aerial_gym.extras import require
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import TrainingCfg

_log = logging.getLogger(__name__)

Listener = Callable[[dict[str, float], int], None]  # Takes scalars by name and their step

_listeners: list[Listener] = []


@contextmanager
def attach_listener(listener: Listener) -> Iterator[None]:
    """Call a function with every scalar that any trainer writes inside the block."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


class SafeEvents:
    """An ``EventsWriter`` that keeps its first error instead of ending the thread that writes."""

    def __init__(self, events: Any, folder: str) -> None:
        self._events, self._folder = events, folder
        self._error: OSError | None = None

    def write_event(self, event: object) -> None:
        """Write an event unless an earlier write failed, and call the listeners."""
        self._keep_first_error(self._events.write_event, event)
        if _listeners:
            self._call_listeners(event)

    @staticmethod
    def _call_listeners(event: Any) -> None:
        scalars = {each.tag: each.simple_value for each in event.summary.value if each.HasField("simple_value")}
        for listener in _listeners if scalars else ():
            listener(scalars, int(event.step))

    def flush(self) -> None:
        """Write the pending events."""
        self._keep_first_error(self._events.flush)

    def close(self) -> None:
        """Write the pending events and close the file."""
        self._keep_first_error(self._events.close)

    def check(self) -> None:
        """Raise ``StorageError`` if something could not be written."""
        if self._error is not None:
            raise StorageError(storage_message(self._error, self._folder))

    def _keep_first_error(self, call: Any, *arguments: object) -> None:
        if self._error is None:
            try:
                call(*arguments)
            except OSError as error:
                self._error = error


def guard_writer(writer: Any) -> SafeEvents:
    """Wrap the file writer of a ``tensorboardX.SummaryWriter`` with an error guard, and return the guard."""
    file_writer = writer._get_file_writer().event_writer
    guarded = SafeEvents(file_writer._ev_writer, writer.logdir)
    file_writer._ev_writer = file_writer._worker._record_writer = guarded
    return guarded


class TensorboardScalars:
    """TensorBoard scalars over environment steps, at most one per second each; idle without ``tensorboardX``.

    The library is imported with the first numbers, when a GPU has work meanwhile.
    """

    INTERVAL_S = 1.0

    def __init__(self, folder: Path) -> None:
        self._folder, self._last = folder, -self.INTERVAL_S
        self._known = importlib.util.find_spec("tensorboardX") is not None
        self._writer: Any = None
        self._events: SafeEvents | None = None

    def add(self, numbers: Callable[[], Mapping[str, float | None]], env_steps: int) -> None:
        """Write numbers at their interval; None stands for a number not yet known."""
        if not self._known or time.perf_counter() - self._last < self.INTERVAL_S:
            return
        self._last = time.perf_counter()
        if self._writer is None:
            from tensorboardX import SummaryWriter

            self._writer = SummaryWriter(str(self._folder))
            self._events = guard_writer(self._writer)
        assert self._events is not None
        self._events.check()
        for name, value in numbers().items():
            if value is not None:
                self._writer.add_scalar(name, value, env_steps)

    def close(self) -> None:
        """Write the pending events."""
        if self._writer is not None:
            self._writer.close()


STEP = "global_step"  # Horizontal axis of scalars: their TensorBoard step, for some of rl-games an epoch or a time


def warn_without_tensorboard() -> None:
    """Log that TensorBoard files are not written if their package is not installed."""
    try:
        require("no TensorBoard files: writing them", "tensorboardX")
    except MissingDependencyError as error:
        _log.warning("%s", error)


def require_wandb() -> None:
    """Raise ``MissingDependencyError`` if the packages of Weights & Biases are not installed."""
    require("--wandb", "wandb", "tensorboardX")


@contextmanager
def send_scalars(project: str, folder: RunFolder, cfg: TrainingCfg) -> Iterator[None]:
    """Send scalars to a run of a project that bears the folder's name; a resumed training continues the same run. The
    library's own variables hold: ``WANDB_MODE=offline`` keeps all in ``wandb/`` of the folder, for ``wandb sync``."""
    import wandb

    file = folder.path / "wandb.json"
    known = json.loads(file.read_text(encoding="utf-8"))["id"] if file.exists() else uuid.uuid4().hex[:8]
    write_atomic(file, json.dumps({"project": project, "id": known}) + "\n")
    run = wandb.init(
        project=project, id=known, name=folder.path.resolve().name, dir=str(folder.path), config=to_mapping(cfg),
        resume="allow", settings=wandb.Settings(console="off", silent=True),
    )  # fmt: skip
    run.define_metric("*", step_metric=STEP)
    try:
        with attach_listener(lambda scalars, step: run.log({**scalars, STEP: step})):
            yield
    finally:
        run.finish()
