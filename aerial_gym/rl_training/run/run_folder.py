"""Run folder of a training: settings, versions, checkpoints, TensorBoard files, learning curve, log.

::

    config.yaml       the resolved settings, from which the run can be repeated
    encoder.pt        a copy of the encoder, where the settings name a file
    versions.json     versions, machine and command of every session
    curve.csv         learning curve: one line per report
    result.json       figures at the end of the last session
    checkpoints/      checkpoint_STEPS.pth: the last two; STEPS are the environment steps of all sessions
    log.txt           output of the libraries
    TRAINER/          files of the trainer, such as summaries/ (TensorBoard)

Files are written whole: a run that is killed at any moment can be continued.
"""

import contextlib
import json
import logging
import os
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from aerial_gym.config import dump_yaml
from aerial_gym.config.storage import read_archive, storage_errors, write_archive, write_atomic
from aerial_gym.errors import ConfigError, StorageError
from aerial_gym.registry.plugins import plugin_versions
from aerial_gym.rl_training.settings import TrainingCfg, load_settings
from aerial_gym.rl_training.trainers.catalog import TRAINERS

VERSIONS = "versions.json"  # File with a line for every session: a folder without it holds no started training
ARRAYS = "policy.npz"  # Weights of a pretrained policy, in place of checkpoints
KEPT_CHECKPOINTS = 2  # The last one, and the one before it in case the disk damages the last

_log = logging.getLogger(__name__)
PACKAGES = ("aerial-gym", "torch", "numpy", "gymnasium", "warp-lang")  # Packages with recorded versions


class RunFolder:
    """Paths and files of one run."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.config_file, self.curve_file = self.path / "config.yaml", self.path / "curve.csv"
        self.result_file, self.log_file = self.path / "result.json", self.path / "log.txt"
        self.versions_file = self.path / VERSIONS
        self.checkpoint_folder = self.path / "checkpoints"
        self.encoder_file = self.path / "encoder.pt"

    def __repr__(self) -> str:
        if not self.config_file.exists():
            return f"RunFolder {self.path}: no run"
        cfg, last = self.config(), ", ".join(path.name for path in self.checkpoints()[-1:]) or "no checkpoint"
        return f"RunFolder {self.path}: {cfg.task}, trainer {cfg.trainer}, {cfg.num_envs} environments; {last}"

    def create(self, cfg: TrainingCfg) -> None:
        """Make the folder and write the settings."""
        if self.config_file.exists():
            raise ConfigError(f"{self.path}: holds a run already. Choose another --out, or continue it with --resume")
        with storage_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
        if cfg.encoder is not None and Path(cfg.encoder).is_file():
            write_atomic(self.encoder_file, Path(cfg.encoder).read_bytes())
        write_atomic(self.config_file, dump_yaml(cfg))

    def discard_unstarted(self) -> None:
        """Remove the files of a training refused before its first session, and the folder if it is then empty."""
        if self.versions_file.exists():
            return
        for file in (self.config_file, self.encoder_file, self.curve_file, self.log_file):
            file.unlink(missing_ok=True)
        if self.path.is_dir() and not any(self.path.iterdir()):
            self.path.rmdir()

    def config(self) -> TrainingCfg:
        """Return the settings of the run; its encoder is the copy in the folder, wherever that is now."""
        if not self.config_file.exists():
            raise ConfigError(f"{self.path}: holds no run (no config.yaml). Start one without --resume")
        cfg = load_settings(self.config_file)
        return replace(cfg, encoder=str(self.encoder_file)) if self.encoder_file.exists() else cfg

    def checkpoints(self) -> list[Path]:
        """Return the checkpoints, oldest first, including those at the places of earlier versions."""
        patterns = [pattern for name in TRAINERS for pattern in TRAINERS.get(name).earlier_checkpoints]
        earlier = [path for pattern in patterns for path in self.path.glob(pattern)]
        earlier.sort(key=lambda path: path.stat().st_mtime_ns)
        return earlier + sorted(self.checkpoint_folder.glob("checkpoint_*.pth")) + sorted(self.path.glob(ARRAYS))

    def last_checkpoint(self) -> Path:
        """Return the newest checkpoint; raise ``ConfigError`` if there is no checkpoint."""
        checkpoints = self.checkpoints()
        if not checkpoints:
            raise ConfigError(f"{self.path}: holds no checkpoint yet. Train on with --out {self.path} --resume")
        return checkpoints[-1]

    def newest_readable_checkpoint(self) -> tuple[Path, dict[str, Any]] | None:
        """Return the newest readable checkpoint with its content; None for a run without a checkpoint. Damaged ones that are
        newer keep their content under the name ``NAME.damaged``, and a warning says so."""
        checkpoints, reasons = self.checkpoints(), []
        for path in reversed(checkpoints):
            try:
                payload = read_archive(path, "checkpoint")
            except ConfigError as error:
                reasons.append((path, str(error)))
                continue
            for damaged, reason in reasons:
                damaged.rename(damaged.with_name(f"{damaged.name}.damaged"))
                _log.warning("%s; continuing from the one before, %s", reason, path)
            return path, payload
        if reasons:
            raise ConfigError(f"{'; '.join(reason for _, reason in reasons)}. Start a new run in another --out")
        return None

    def write_checkpoint(self, env_steps: int, payload: dict[str, object]) -> Path:
        """Write a checkpoint after so many steps of all sessions, then remove all but the last two."""
        path = self.checkpoint_folder / f"checkpoint_{env_steps:015d}.pth"
        try:
            with storage_errors(path):
                self.checkpoint_folder.mkdir(exist_ok=True)
            write_archive(path, payload)
        except StorageError as error:
            known = self.checkpoints()
            left = f"The last checkpoint is {known[-1]}; --resume goes on there" if known else "There is no checkpoint"
            raise StorageError(f"{error}. {left}") from None
        for old in sorted(self.checkpoint_folder.glob("checkpoint_*.pth"))[:-KEPT_CHECKPOINTS]:
            old.unlink(missing_ok=True)
        for torn in self.checkpoint_folder.glob(".*.partial"):
            torn.unlink(missing_ok=True)
        return path

    def add_session(self, cfg: TrainingCfg, device: str) -> None:
        """Append seed, device, versions and machine of this session to ``versions.json``. Waits until no file of TensorBoard
        has the present second in its name: one of this session would replace it."""
        while any(self.path.rglob(f"events.out.tfevents.{int(time.time())}.*")):
            time.sleep(0.05)
        append_session(self.path, seed=cfg.seed, device=device)

    @contextlib.contextmanager
    def redirect_output(self) -> Iterator[None]:
        """Redirect prints and logs of the block to ``log.txt``."""
        with self.log_file.open("a", encoding="utf-8", errors="surrogateescape", buffering=1) as log:
            handler = logging.StreamHandler(log)
            root = logging.getLogger()
            root.addHandler(handler)
            try:
                with contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
                    yield
            finally:
                root.removeHandler(handler)
                sys.stdout.flush()


def append_session(folder: Path, *, seed: int, device: str) -> None:
    """Append seed, device, versions and machine of a session to ``versions.json`` of a folder."""
    file = folder / VERSIONS
    sessions = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
    sessions.append(
        {
            "started": datetime.now(UTC).isoformat(timespec="seconds"), "seed": seed, "device": device,
            "versions": {"python": platform.python_version(), **_package_versions()},
            "machine": f"{platform.platform()}, {os.cpu_count()} CPU cores",
        }
    )  # fmt: skip
    write_atomic(file, json.dumps(sessions, indent=1) + "\n")


def run_folder_of_checkpoint(checkpoint: str | Path) -> RunFolder:
    """Return the run folder in which a checkpoint lies."""
    checkpoint = Path(checkpoint).resolve()
    if not checkpoint.is_file():
        raise ConfigError(f"checkpoint {checkpoint}: no such file")
    for folder in checkpoint.parents[:3]:
        if (folder / "config.yaml").exists():
            return RunFolder(folder)
    raise ConfigError(f"checkpoint {checkpoint}: no config.yaml in the folders above it, so its network is not known")


def _package_versions() -> dict[str, str]:
    versions = {}
    libraries = (TRAINERS.get(name).distribution for name in TRAINERS)
    for name in (*PACKAGES, *filter(None, libraries)):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return versions | plugin_versions
