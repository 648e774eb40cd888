"""Warp's start, and Warp launches on torch's current stream, so that both see each other's work in order."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import torch
import warp as wp

from aerial_gym.errors import StorageError
from aerial_gym.interop.kernel_log import KernelLog
from aerial_gym.interop.launches import wait_for_all

CHOOSE_CACHE = "Set WARP_CACHE_PATH to a folder that can be written"
"""Remedy where compiled kernels cannot be kept."""

BLOCK_DIM = 64
"""Threads of a block on a GPU in kernels of one thread per environment: Warp's 256 leave most multiprocessors of a large GPU
without work at some thousand environments."""


def start_warp() -> None:
    """Initialise Warp without its banner; what it compiles is told by ``KernelLog``. A log level or a logger that the user
    chose stays.

    Without a GPU, Warp's native library writes a warning about a missing driver, past Python, that nobody can act on: the
    process's stderr is closed to it meanwhile.

    Raises:
        StorageError: If Warp cannot keep compiled kernels; the message names the variable that says where.
    """
    if not {"WARP_CACHE_PATH", "XDG_CACHE_HOME"} & os.environ.keys() and os.path.expanduser("~") == "~":
        raise StorageError(f"this user has no home folder to keep compiled kernels in. {CHOOSE_CACHE}")
    if wp.config.log_level == wp.LOG_INFO and type(wp.get_logger()).__module__.startswith("warp."):
        wp.set_logger(KernelLog())
    try:
        with nullcontext() if torch.cuda.is_available() else _silent_stderr():
            wp.init()
    except OSError as error:
        raise StorageError(_no_cache(error.filename, error.strerror or str(error))) from None
    cache = wp.config.kernel_cache_dir
    if cache is not None and not os.access(cache, os.W_OK) and not os.listdir(cache):
        raise StorageError(_no_cache(cache, "it is empty and read-only"))


def _no_cache(folder: str | None, reason: str) -> str:
    """Return the message on a folder that takes no compiled kernels."""
    return f"{folder}: Warp cannot keep compiled kernels there ({reason.lower()}). {CHOOSE_CACHE}"


@contextmanager
def _silent_stderr() -> Iterator[None]:
    sys.stderr.flush()
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


@contextmanager
def on_device(device: torch.device) -> Iterator[None]:
    """Make a GPU torch's current one inside; a CPU changes nothing."""
    with torch.cuda.device(device) if device.type == "cuda" else nullcontext():
        yield


@contextmanager
def recorded(graph: torch.cuda.CUDAGraph, device: torch.device, *, errors: str = "global") -> Iterator[None]:
    """Record what is launched inside into a CUDA graph, on a stream of its own GPU.

    torch's own stream for recordings belongs to the GPU of the first one. Kernels that are still being compiled are waited for:
    a GPU loads none during a recording.

    Args:
        graph: Receives the launches.
        device: Where they run.
        errors: What torch forbids meanwhile, its ``capture_error_mode``.
    """
    wait_for_all()
    stream = torch.cuda.Stream(device)
    with on_device(device), torch.cuda.graph(graph, stream=stream, capture_error_mode=errors):
        yield
