"""The folder that a training leaves: settings, versions, checkpoints, TensorBoard files, learning curve, log.

::

    config.yaml       the resolved settings, from which the run can be repeated
    versions.json     versions, machine and command of every session
    curve.csv         learning curve: one line per report
    result.json       figures at the end of the last session
    curriculum.json   level and counts of the curriculum at that moment, where the task has one
    log.txt           what the libraries print
    rl_games/         nn/last.pth, summaries/ (TensorBoard)
    sample_factory/   checkpoint_p0/*.pth, .summary/ (TensorBoard), config.json
"""

import contextlib
import json
import logging
import os
import platform
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from aerial_gym.config import dump_yaml
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.settings import TrainingCfg, load_settings

PACKAGES = ("aerial-gym", "torch", "numpy", "gymnasium", "warp-lang", "rl-games", "sample-factory")
"""Packages whose versions are written down."""


class RunFolder:
    """Paths and files of one run."""

    def __init__(self, path: str | Path) -> None:
        """Take the folder; nothing is made yet."""
        self.path = Path(path)
        self.config_file, self.curve_file = self.path / "config.yaml", self.path / "curve.csv"
        self.result_file, self.log_file = self.path / "result.json", self.path / "log.txt"
        self.curriculum_file = self.path / "curriculum.json"

    def create(self, cfg: TrainingCfg) -> None:
        """Make the folder and write the settings.

        Raises:
            ConfigError: If a run stands there already.
        """
        if self.config_file.exists():
            raise ConfigError(f"{self.path}: holds a run already. Choose another --out, or continue it with --resume")
        self.path.mkdir(parents=True, exist_ok=True)
        self.config_file.write_text(dump_yaml(cfg), encoding="utf-8")

    def config(self) -> TrainingCfg:
        """Return the settings of the run.

        Raises:
            ConfigError: If the folder holds no run.
        """
        if not self.config_file.exists():
            raise ConfigError(f"{self.path}: holds no run (no config.yaml). Start one without --resume")
        return load_settings(self.config_file)

    def checkpoints(self) -> list[Path]:
        """Return the checkpoints, oldest first."""
        found = [*self.path.glob("rl_games/nn/*.pth"), *self.path.glob("sample_factory/checkpoint_p0/checkpoint_*.pth")]
        return sorted(found, key=lambda path: path.stat().st_mtime_ns)

    def last_checkpoint(self) -> Path:
        """Return the newest checkpoint.

        Raises:
            ConfigError: If there is none.
        """
        found = self.checkpoints()
        if not found:
            raise ConfigError(f"{self.path}: holds no checkpoint. Train with --out {self.path} first")
        return found[-1]

    def add_session(self, cfg: TrainingCfg, device: str) -> None:
        """Append seed, device, versions and machine of this session to ``versions.json``."""
        file = self.path / "versions.json"
        sessions = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
        sessions.append(
            {
                "started": datetime.now(UTC).isoformat(timespec="seconds"),
                "seed": cfg.seed,
                "device": device,
                "versions": {"python": platform.python_version(), **_versions()},
                "machine": f"{platform.platform()}, {os.cpu_count()} CPU cores",
            }
        )
        file.write_text(json.dumps(sessions, indent=1) + "\n", encoding="utf-8")

    @contextlib.contextmanager
    def captured_output(self) -> Iterator[None]:
        """Send what Python code prints or logs inside to ``log.txt``."""
        with self.log_file.open("a", encoding="utf-8", buffering=1) as log:
            handler = logging.StreamHandler(log)
            root = logging.getLogger()
            root.addHandler(handler)
            try:
                with contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
                    yield
            finally:
                root.removeHandler(handler)
                sys.stdout.flush()


def run_folder_of(checkpoint: str | Path) -> RunFolder:
    """Return the run folder in which a checkpoint lies.

    Raises:
        ConfigError: If the file does not exist, or no folder above it holds a run.
    """
    checkpoint = Path(checkpoint).resolve()
    if not checkpoint.is_file():
        raise ConfigError(f"checkpoint {checkpoint}: no such file")
    for folder in checkpoint.parents[:3]:
        if (folder / "config.yaml").exists():
            return RunFolder(folder)
    raise ConfigError(f"checkpoint {checkpoint}: no config.yaml in the folders above it, so its network is not known")


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found
