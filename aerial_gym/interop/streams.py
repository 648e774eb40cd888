"""Initialisation of Warp, and Warp launches on torch's current stream, in order with torch's work."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import torch
import warp as wp

from aerial_gym.errors import StorageError
from aerial_gym.interop.kernel_log import KernelLog
from aerial_gym.interop.launches import wait_for_all

CHOOSE_CACHE = "Set WARP_CACHE_PATH to a folder that can be written"  # Remedy for a cache that cannot be written

BLOCK_DIM = 64
"""Block size on a GPU for kernels of one thread per environment: with Warp's 256, a few thousand environments leave most
multiprocessors of a large GPU idle."""


def start_warp() -> None:
    """Initialise Warp without its banner, with ``KernelLog`` for compilations unless the user chose a log level or logger.

    Without a GPU, Warp's native library warns of a missing driver directly on stderr, which is muted meanwhile.

    Raises:
        StorageError: If Warp cannot store compiled kernels; the message names the variable for the folder.
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
    """Return the message for a cache folder that cannot be written."""
    return f"{folder}: Warp cannot keep compiled kernels there ({reason.lower()}). {CHOOSE_CACHE}"


@contextmanager
def _silent_stderr() -> Iterator[None]:
    sys.stderr.flush()
    kept, null_device = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null_device)


@contextmanager
def on_device(device: torch.device) -> Iterator[None]:
    """Make a GPU torch's current device; no effect for the CPU."""
    with torch.cuda.device(device) if device.type == "cuda" else nullcontext():
        yield


@contextmanager
def record_graph(graph: torch.cuda.CUDAGraph, device: torch.device, *, errors: str = "global") -> Iterator[None]:
    """Capture launches into a CUDA graph, on a stream of the given GPU.

    torch's own capture stream belongs to the GPU of the first capture. Pending compilations are awaited first, because a GPU
    loads no kernel during a capture.

    Args:
        graph: Receives the launches.
        errors: torch's ``capture_error_mode``.
    """
    wait_for_all()
    stream = torch.cuda.Stream(device)
    with on_device(device), torch.cuda.graph(graph, stream=stream, capture_error_mode=errors):
        yield
