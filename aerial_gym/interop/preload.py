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

NATIVE = ("numpy", "yaml", "asyncio", "cProfile", "csv", "hashlib", "multiprocessing", "queue", "uuid")
"""Modules with native code that Warp and PyTorch import. They load first: glibc loads one library at a time, and those of
PyTorch take long."""

BESIDE = ("warp", "aerial_gym.config.environment", "aerial_gym.config.robot", "aerial_gym.config.task")
"""Modules that take long to import and do not need PyTorch."""

TORCH_LIBRARIES = ("libtorch_global_deps.so", "libtorch_cpu.so", "libtorch_cuda.so")


def preload(device: str | None) -> list[threading.Thread]:
    """Start threads that load libraries and the context of a GPU, and return them.

    Args:
        device: ``cuda``, ``cuda:N``, or ``auto`` or None for the first GPU if there is one.
    """
    if sys.platform != "linux":
        return []
    kind, _, number = (device or "auto").partition(":")
    number = number or os.environ.get("LOCAL_RANK") or "0"  # torchrun's number of the process on this machine
    threads = [threading.Thread(target=_load_torch, name="preload libraries", daemon=True)]
    if kind in ("auto", "cuda") and number.isdecimal():
        threads.append(threading.Thread(target=_load_gpu, args=(int(number),), name="preload GPU", daemon=True))
    for name in NATIVE:
        import_module(name)
    for thread in threads:
        thread.start()
    return threads


def import_without_torch() -> None:
    """Import modules that do not need PyTorch, while the threads of ``preload`` load libraries."""
    for name in BESIDE:
        import_module(name)


def _load_torch() -> None:
    for library in TORCH_LIBRARIES:
        _open(_library("torch", f"lib/{library}"))


def _load_gpu(index: int) -> None:
    """Create the primary context of a GPU, which is kept until the process ends, and load Warp's library."""
    if not _open("libcuda.so.1"):
        return
    driver, handle, context = ctypes.CDLL("libcuda.so.1"), ctypes.c_int(), ctypes.c_void_p()
    if driver.cuInit(0) == 0 and driver.cuDeviceGet(ctypes.byref(handle), index) == 0:
        driver.cuDevicePrimaryCtxRetain(ctypes.byref(context), handle)
        for library in ("warp.so", "warp-clang.so"):
            _open(_library("warp", f"bin/{library}"))


def _library(package: str, file: str) -> str:
    """Return the path of a package's library, without importing the package."""
    spec = find_spec(package)
    folders = (spec.submodule_search_locations or [""]) if spec is not None else [""]
    return str(Path(folders[0]) / file)


def _open(library: str) -> bool:
    """Load a library while other threads run Python; return False if it or a dependency is missing.

    ``ctypes.CDLL`` keeps Python's lock during the load; a call of the C function ``dlopen`` releases it.
    """
    load = ctypes.CDLL(None).dlopen
    load.argtypes, load.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    return load(os.fsencode(library), os.RTLD_NOW) is not None
