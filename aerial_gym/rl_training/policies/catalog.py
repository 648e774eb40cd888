"""Policies that come with the package, by name: run folders with settings, and weights as arrays. Imports no torch.

Each ``source`` states the command that trained it. ``python -m benchmarks.learning.policies`` evaluates all.
"""

from pathlib import Path
from types import SimpleNamespace

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.loader import read_summary
from aerial_gym.registry import Registry
from aerial_gym.registry.registry import register_files

PREFIX = Path("pretrained")  # In front of names: ``--policy pretrained/NAME``
PRETRAINED: Registry[SimpleNamespace] = Registry("pretrained policy")  # `path` of the run folder and `summary` by task


def _read_entry(file: Path) -> SimpleNamespace:
    return SimpleNamespace(path=file.parent, summary=read_summary(file))


_settings = {file.parent.name: file for file in sorted(CONFIG_DIR.joinpath(PREFIX).glob("*/config.yaml"))}
register_files(PRETRAINED, _settings, _read_entry, summary=read_summary)


def policy_path(source: str | Path) -> Path:
    """Return the run folder of ``pretrained/NAME``, and any other source and existing file unchanged.

    Raises:
        UnknownNameError: If there is no pretrained policy of this name.
    """
    path = Path(source)
    return PRETRAINED.get(path.name).path if path.parent == PREFIX and not path.exists() else path
