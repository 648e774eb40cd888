"""Policies that come with the package, by name: run folders with settings, and weights as arrays. Imports no torch.

Each ``source`` states the command that trained it. ``python -m benchmarks.learning.policies`` evaluates all.
"""

from pathlib import Path

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.loader import read_summary
from aerial_gym.registry import Registry
from aerial_gym.registry.registry import register_files

PREFIX = Path("pretrained")  # In front of names: ``--policy pretrained/NAME``
PRETRAINED: Registry[Path] = Registry("pretrained policy")  # Run folder of each policy, under the name of its task

_settings = sorted(CONFIG_DIR.joinpath(PREFIX).glob("*/config.yaml"))
register_files(
    PRETRAINED, {file.parent.name: file for file in _settings}, lambda file: file.parent, summary=read_summary
)


def policy_path(source: str | Path) -> Path:
    """Return the run folder of ``pretrained/NAME``, and any other source and existing file unchanged.

    Raises:
        UnknownNameError: If there is no pretrained policy of this name.
    """
    path = Path(source)
    return PRETRAINED.get(path.name) if path.parent == PREFIX and not path.exists() else path
