"""Preloading of the native libraries of PyTorch and Warp, and of a GPU's context, on a thread during imports.

This module imports neither torch nor Warp. Both then find the loaded libraries and the context.
"""

import ctypes
import os
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec

NATIVE = ("numpy", "yaml", "asyncio", "cProfile", "csv", "hashlib", "multiprocessing", "queue", "uuid")
"""Modules with native code that Warp and PyTorch import. They load first: glibc loads one library at a time, and those of
PyTorch take long. Python's lock would be held meanwhile."""

BESIDE = ("warp", "aerial_gym.config.environment", "aerial_gym.config.robot", "aerial_gym.config.task")
"""Modules that take long to import and do not need PyTorch."""

TORCH_LIBRARIES = ("libtorch_global_deps.so", "libtorch_cpu.so", "libtorch_cuda.so")
WARP_LIBRARIES = ("warp.so", "warp-clang.so")


def preload(device: str | None) -> list[threading.Thread]:
    """Start threads that load libraries and the context of a GPU, and return them.

    Args:
        device: ``cuda``, ``cuda:N``, or ``auto`` or None for the first GPU if there is one.
    """
    if sys.platform != "linux":
        return []
    kind, _, number = (device or "auto").partition(":")
    number = number or os.environ.get("LOCAL_RANK") or "0"  # torchrun's number of the process on this machine
    threads = []
    driver = _load_driver() if kind in ("auto", "cuda") and number.isdecimal() else None
    if driver is not None:
        threads.append(_start_thread(_load_gpu, *driver, int(number)))
    for name in NATIVE:
        import_module(name)
    return [*threads, _start_thread(_load_torch_and_triton, driver is not None)]


def import_without_torch() -> None:
    """Import modules that do not need PyTorch, while the threads of ``preload`` load libraries."""
    for name in BESIDE:
        import_module(name)


def _start_thread(function: Callable[..., None], *arguments: object) -> threading.Thread:
    thread = threading.Thread(target=function, args=arguments, name="preload", daemon=True)
    thread.start()
    return thread


DriverCall = Callable[..., int]  # Function of the CUDA driver, which returns 0 if it succeeds


def _load_driver() -> tuple[DriverCall, ...] | None:
    """Return the driver's functions for a context; None without a driver."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return None
    return driver.cuInit, driver.cuDeviceGet, driver.cuDevicePrimaryCtxRetain


def _load_gpu(initialize: DriverCall, get_device: DriverCall, retain_context: DriverCall, index: int) -> None:
    """Create the primary context of a GPU, which is kept until the process ends, and load Warp's libraries."""
    handle, context = ctypes.c_int(), ctypes.c_void_p()
    if initialize(0) == 0 and get_device(ctypes.byref(handle), index) == 0:
        retain_context(ctypes.byref(context), handle)
        _load("warp", "bin", WARP_LIBRARIES)


def _load_torch_and_triton(gpu: bool) -> None:
    """Load PyTorch's libraries; for a GPU also Triton, which hashes its own files for 0.4 s before its first kernel."""
    _load("torch", "lib", TORCH_LIBRARIES)
    if gpu:
        _load("triton", "_C", ("libtriton.so",))
        with suppress(Exception):  # those who use Triton report its errors
            import_module("triton.runtime.cache").triton_key()


def _load(package: str, folder: str, libraries: Sequence[str]) -> None:
    """Load libraries of a package, without importing it; their users report missing ones later."""
    spec = find_spec(package)
    for home in spec.submodule_search_locations or () if spec is not None else ():
        for library in libraries:
            _dlopen(os.fsencode(os.path.join(home, folder, library)), os.RTLD_NOW)


def _find_dlopen() -> Callable[[bytes, int], object]:
    """Return the C function ``dlopen``, during which other threads run Python; ``ctypes.CDLL`` keeps Python's lock."""
    function = ctypes.CDLL(None).dlopen
    function.argtypes, function.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    return function


_dlopen = _find_dlopen() if sys.platform == "linux" else lambda *_: None
