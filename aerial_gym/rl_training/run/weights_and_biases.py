"""Copies of a training's TensorBoard scalars to Weights & Biases, for any trainer."""

import importlib.util
import json
import uuid
from collections.abc import Iterator
from contextlib import contextmanager

from aerial_gym.config import to_mapping
from aerial_gym.config.storage import write_atomic
from aerial_gym.errors import MissingDependencyError
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.summaries import attach_listener

STEP = "global_step"  # Horizontal axis of scalars: their TensorBoard step, for some of rl-games an epoch or a time


def require_wandb() -> None:
    """Raise ``MissingDependencyError`` if the package ``wandb`` is not installed."""
    for package in ("wandb", "tensorboardX"):
        if importlib.util.find_spec(package) is None:
            raise MissingDependencyError(f"--wandb needs the package {package!r}: pip install 'aerial-gym[wandb]'")


@contextmanager
def send_scalars(project: str, folder: RunFolder, cfg: TrainingCfg) -> Iterator[None]:
    """Send scalars to a run of a project that bears the folder's name; a resumed training continues the same run.

    The library's own variables hold: ``WANDB_MODE=offline`` keeps all in ``wandb/`` of the folder, for ``wandb sync``.
    """
    import wandb

    file = folder.path / "wandb.json"
    known = json.loads(file.read_text(encoding="utf-8"))["id"] if file.exists() else uuid.uuid4().hex[:8]
    write_atomic(file, json.dumps({"project": project, "id": known}) + "\n")
    run = wandb.init(
        project=project,
        id=known,
        name=folder.path.resolve().name,
        dir=str(folder.path),
        config=to_mapping(cfg),
        resume="allow",
        settings=wandb.Settings(console="off", silent=True),
    )
    run.define_metric("*", step_metric=STEP)
    try:
        with attach_listener(lambda scalars, step: run.log({**scalars, STEP: step})):
            yield
    finally:
        run.finish()
