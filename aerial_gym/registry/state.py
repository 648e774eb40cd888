"""The state of a simulation as a flat dictionary of tensors: everything on which its future depends.

Owners of such tensors list them by name, ``state_tensors() -> dict[str, Tensor]``; the tensors keep their memory, so that
loading is a copy. ``torch.save`` writes the dictionary, ``torch.load(..., weights_only=True)`` reads it.
"""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError

PACKAGE = Path(__file__).resolve().parents[1]  # Left out of digests: they hold in any place of installation
IDENTITY = "identity."  # Prefix of the names of digests, which identify the simulation of a state


def config_digest(config: object) -> Tensor:
    """Return a configuration as a number, int64, (1,), the same in every process and place of the package."""
    text = re.sub(r" at 0x[0-9a-f]+", "", _text_of_fields(config).replace(str(PACKAGE), ""))
    return torch.tensor([int.from_bytes(hashlib.sha256(text.encode()).digest()[:7], "big")])


def _text_of_fields(config: object) -> str:
    """Return the names and values of all fields, also of a class with a short ``repr``."""
    if not is_dataclass(config):
        return repr(config)
    values = ", ".join(f"{each.name}={getattr(config, each.name)!r}" for each in fields(config) if each.repr)
    return f"{type(config).__qualname__}({values})"


def config_digests(**configs: object) -> dict[str, Tensor]:
    """Return the digests of a simulation's configurations, by name."""
    return {f"{IDENTITY}{name}": config_digest(config) for name, config in configs.items()}


def describe_own_code(entries: Mapping[str, object]) -> dict[str, str]:
    """Return class and attributes of registered entries from other packages, for a digest.

    As for the package's own entries, the source is not compared.
    """
    own = {name: entry for name, entry in entries.items() if not _module(entry).startswith("aerial_gym.")}
    attributes = {
        name: {} if isinstance(entry, type) else getattr(entry, "__dict__", {}) for name, entry in own.items()
    }
    return {name: f"{_module(entry)} {entry!r} {attributes[name]!r}" for name, entry in own.items()}


def _module(entry: object) -> str:
    return getattr(entry, "__module__", type(entry).__module__)


def add_prefix(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return tensors with ``prefix.`` in front of their names."""
    return {f"{prefix}.{name}": tensor for name, tensor in tensors.items()}


def copy_tensors(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return independent copies."""
    return {name: tensor.detach().clone() for name, tensor in tensors.items()}


def check_state(state: Mapping[str, Tensor], own: Mapping[str, Tensor]) -> None:
    """Raise ``ConfigError`` if a state is not one of the simulation with these tensors; the message says why."""
    for name, tensor in own.items():
        if name.startswith(IDENTITY) and name in state and not torch.equal(state[name].cpu(), tensor.cpu()):
            raise ConfigError(
                f"state: is of another {name.removeprefix(IDENTITY)}. Build the simulation with the one of the state"
            )
    unknown, missing = sorted(state.keys() - own.keys()), sorted(own.keys() - state.keys())
    if unknown or missing:
        difference = f"has {unknown[0]!r}, unknown here" if unknown else f"lacks {missing[0]!r}"
        raise ConfigError(f"state: {difference}; it is of another simulation, or of another version")
    for name, tensor in own.items():
        given = state[name]
        if given.shape != tensor.shape or given.dtype != tensor.dtype:
            raise ConfigError(
                f"state: {name} is {tuple(given.shape)} {given.dtype}, here {tuple(tensor.shape)} {tensor.dtype}. "
                "The number of environments must be the same"
            )


def restore_tensors(state: Mapping[str, Tensor], own: Mapping[str, Tensor]) -> None:
    """Copy a state into the tensors of a simulation."""
    for name, tensor in own.items():
        if not name.startswith(IDENTITY):
            tensor.copy_(state[name])
