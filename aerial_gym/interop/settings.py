"""Torch's global settings, and the choice of a torch device by name.

This package computes with the defaults, whatever a program has set: float32, no default device and no inference mode, whose
tensors can never be written in place outside it.
"""

from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from inspect import isfunction
from threading import local
from typing import ParamSpec, TypeVar

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from aerial_gym.errors import ConfigError, ShapeError


def resolve_device(name: str | torch.device) -> torch.device:
    """Return the torch device of a name; ``auto`` and ``cuda`` take torch's current GPU, which is the first by default.

    ``auto`` takes the CPU if there is no GPU.

    Raises:
        ConfigError: If the name is no device, or names a missing GPU.
    """
    if str(name) == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise ConfigError(f"device {name!r}: must be auto, cpu, cuda or cuda:N") from None
    if device.type == "cuda":
        count = torch.cuda.device_count()
        chosen = torch.cuda.current_device() if torch.cuda.is_initialized() else 0  # a query would initialise CUDA
        index = chosen if device.index is None else device.index
        if index >= count:
            raise ConfigError(f"device {str(name)!r}: this machine shows {count} CUDA devices. Use device='cpu'.")
        return torch.device("cuda", index)
    return plain_device(device)


def plain_device(name: str | torch.device) -> torch.device:
    """Return the torch device of a name, without the index of a CPU, as tensors report it: ``cpu:0`` becomes ``cpu``."""
    device = torch.device(name)
    return torch.device("cpu") if device.type == "cpu" else device


def action_tensor(actions: Tensor | ArrayLike, device: torch.device) -> Tensor:
    """Return a tensor unchanged, and an array or list as a float32 tensor on the device.

    Raises:
        ShapeError: If it is no array of numbers.
    """
    if isinstance(actions, Tensor):
        return actions
    try:
        return torch.from_numpy(np.array(actions, dtype=np.float32)).to(device)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"actions: must be a tensor or an array of numbers ({error})") from None


P = ParamSpec("P")
T = TypeVar("T")
C = TypeVar("C", bound=type)

USUAL_DEVICE = torch.device("cpu")  # Torch's default device
_thread = local()  # Whether this thread is inside `usual_settings`, with known settings


def usual_settings(function: Callable[P, T]) -> Callable[P, T]:
    """Return the function run with torch's default settings; the caller's are restored afterwards."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        if getattr(_thread, "inside", False):
            return function(*args, **kwargs)
        with ExitStack() as settings:
            _restore_default_settings(torch.empty(0), settings)
            _thread.inside = True
            settings.callback(setattr, _thread, "inside", False)
            return function(*args, **kwargs)

    return run


def _restore_default_settings(made: Tensor, settings: ExitStack) -> None:
    """Restore the default settings where a default tensor shows others, until the stack closes."""
    if made.dtype is not torch.float32:
        settings.callback(torch.set_default_dtype, made.dtype)
        torch.set_default_dtype(torch.float32)
    if made.device != USUAL_DEVICE:
        settings.enter_context(USUAL_DEVICE)
    if made.is_inference():
        settings.enter_context(torch.inference_mode(mode=False))  # with gradients enabled, for training


def with_usual_settings(cls: C) -> C:
    """Decorate a class: its constructor and public methods run with torch's default settings."""
    for name, member in list(vars(cls).items()):
        if isfunction(member) and (name == "__init__" or not name.startswith("_")):
            setattr(cls, name, usual_settings(member))
    return cls
