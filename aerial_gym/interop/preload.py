"""Preloading of the native libraries of PyTorch and Warp, and of a GPU's context, on a thread during imports.

This module imports neither torch nor Warp. Both then find the loaded libraries and the context.
"""

import ctypes
import os
import sys
import threading
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

BESIDE = ("warp", "aerial_gym.config.environment", "aerial_gym.config.robot", "aerial_gym.config.task")
"""Modules that take long to import and do not need PyTorch."""


def preload(device: str | None) -> threading.Thread:
    """Start a thread that loads libraries and the context of a GPU, and return it.

    Args:
        device: ``cuda``, ``cuda:N``, or ``auto`` or None for the first GPU if there is one.
    """
    kind, _, number = (device or "auto").partition(":")
    number = number or os.environ.get("LOCAL_RANK") or "0"  # torchrun's number of the process on this machine
    index = int(number) if kind in ("auto", "cuda") and number.isdecimal() else None
    thread = threading.Thread(target=_load, args=(index,), name="preload", daemon=True)
    if sys.platform == "linux":
        thread.start()
    return thread


def import_without_torch() -> None:
    """Import modules that do not need PyTorch, while the thread of ``preload`` loads PyTorch's libraries."""
    for name in BESIDE:
        import_module(name)


def _load(index: int | None) -> None:
    if _open(_library("torch", "lib/libtorch_cuda.so")) is None:
        _open(_library("torch", "lib/libtorch_cpu.so"))
    driver = None if index is None else _open("libcuda.so.1")
    handle = ctypes.c_int()
    if driver is not None and driver.cuInit(0) == 0 and driver.cuDeviceGet(ctypes.byref(handle), index) == 0:
        context = ctypes.c_void_p()
        driver.cuDevicePrimaryCtxRetain(ctypes.byref(context), handle)  # kept until the process ends
        _open(_library("warp", "bin/warp.so"))


def _library(package: str, file: str) -> str:
    """Return the path of a package's library, without importing the package."""
    spec = find_spec(package)
    folders = (spec.submodule_search_locations or [""]) if spec is not None else [""]
    return str(Path(folders[0]) / file)


def _open(library: str) -> ctypes.CDLL | None:
    """Load a library; None if it or a dependency is missing, which its user reports later."""
    try:
        return ctypes.CDLL(library)
    except OSError:
        return None
