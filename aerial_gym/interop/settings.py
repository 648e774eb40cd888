"""Torch's global settings: a program may change them for its own code, and this package computes with the usual ones.

The usual ones are float32 as default type, no default device and no inference mode: tensors that are made under inference
mode can never be written in place outside it.
"""

from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from inspect import isfunction
from threading import local
from typing import ParamSpec, TypeVar

import torch
from torch import Tensor

P = ParamSpec("P")
T = TypeVar("T")
C = TypeVar("C", bound=type)

USUAL_DEVICE = torch.device("cpu")
"""Where torch makes tensors if nothing else was asked for."""

_thread = local()
"""Whether this thread is inside of ``usual_settings``: its settings are then known."""


def usual_settings(function: Callable[P, T]) -> Callable[P, T]:
    """Return the function, run with torch's usual settings whatever the caller has set; the caller's are put back."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        if getattr(_thread, "inside", False):
            return function(*args, **kwargs)
        with ExitStack() as settings:
            _take_usual(torch.empty(0), settings)
            _thread.inside = True
            settings.callback(setattr, _thread, "inside", False)
            return function(*args, **kwargs)

    return run


def _take_usual(made: Tensor, settings: ExitStack) -> None:
    """Change the settings that a tensor of default type and place shows to be unusual, until the stack is closed."""
    if made.dtype is not torch.float32:
        settings.callback(torch.set_default_dtype, made.dtype)
        torch.set_default_dtype(torch.float32)
    if made.device != USUAL_DEVICE:
        settings.enter_context(USUAL_DEVICE)
    if made.is_inference():
        settings.enter_context(torch.inference_mode(mode=False))  # gradients are on again, for those who train


def with_usual_settings(cls: C) -> C:
    """Return the class; its constructor and public methods run with torch's usual settings."""
    for name, member in list(vars(cls).items()):
        if isfunction(member) and (name == "__init__" or not name.startswith("_")):
            setattr(cls, name, usual_settings(member))
    return cls
