"""Initialisation of Warp without torch, and a log of compilations.

Compilations are logged through ``logging``, because the first ones on a machine take seconds.
"""

import ctypes
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import cache

import warp as wp

from aerial_gym.errors import StorageError

_log = logging.getLogger(__name__)
_COMPILED = re.compile(
    r"Module (?P<module>\S+) \S+ load on device '(?P<device>[^']*)' took (?P<ms>[\d.]+) ms\s+\(compiled\)"
)


class KernelLog:
    """A logger for Warp (``wp.set_logger``) that reports compilations only."""

    def __init__(self) -> None:
        self._told = False

    def info(self, message: str) -> None:
        """Log a compiled module; drop Warp's banner and modules from the cache."""
        match = _COMPILED.search(message)
        if match is None:
            return
        summary = f"{match['module']} for {match['device']} in {float(match['ms']) / 1000.0:.1f} s"
        kept = "" if self._told else f"; once for this machine, kept in {wp.config.kernel_cache_dir}"
        self._told = True
        _log.warning("compiled %s%s", summary, kept)

    def debug(self, message: str) -> None:
        """Log debug messages of Warp, which ``wp.config.log_level`` enables."""
        _log.debug(message)

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        """Issue a warning of Warp."""
        warnings.warn(message, category, stacklevel=stacklevel + 1)

    def error(self, message: str) -> None:
        """Log an error."""
        _log.error(message)


@contextmanager
def silent_compilations() -> Iterator[None]:
    """Log no compiled modules meanwhile, because a command shows its progress itself."""
    level = _log.level
    _log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        _log.setLevel(level)


CHOOSE_CACHE = "Set WARP_CACHE_PATH to a folder that can be written"  # Remedy for a cache that cannot be written


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
        with nullcontext() if has_gpu_driver() else _silent_stderr():
            wp.init()
    except OSError as error:
        raise StorageError(_message_of_unwritable_cache(error.filename, error.strerror or str(error))) from None
    cache = wp.config.kernel_cache_dir
    if cache is not None and not os.access(cache, os.W_OK) and not os.listdir(cache):
        raise StorageError(_message_of_unwritable_cache(cache, "it is empty and read-only"))


def _message_of_unwritable_cache(folder: str | None, reason: str) -> str:
    """Return the message for a cache folder that cannot be written."""
    return f"{folder}: Warp cannot keep compiled kernels there ({reason.lower()}). {CHOOSE_CACHE}"


@cache  # a missing library is searched for in every folder again
def has_gpu_driver() -> bool:
    """Return whether the driver of an NVIDIA GPU is installed."""
    try:
        ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return False
    return True


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
