"""Start of a command's process: clock, parallel loading of libraries, bytecode cache."""

import os
import sys
import time
from importlib.util import cache_from_source, find_spec
from pathlib import Path

from aerial_gym.interop.preload import preload

_started: float | None = None


def start_clock_and_preload() -> None:
    """Note the start of this process, preload libraries of a training, cache bytecode; called by ``entry``."""
    global _started
    _started = time.perf_counter() - time.process_time()  # the interpreter's own start counts
    cache_bytecode()
    if "train" in sys.argv[1:3] and not {"-h", "--help"} & set(sys.argv):
        preload(_training_device(sys.argv))


def _training_device(argv: list[str]) -> str:
    """Return the device that a command line names; else ``auto``, or ``cpu`` if a file of settings names it."""
    words = [part for word in argv for part in word.split("=", 1)]
    if "--device" in words[:-1]:
        return words[words.index("--device") + 1]
    return "cpu" if {"--resume", "--config"} & set(words) else "auto"


def start_time() -> float:
    """Return the start of the command on the clock of ``time.perf_counter`` [s]: that of the process, or now without one."""
    return time.perf_counter() if _started is None else _started


def cache_bytecode() -> None:
    """Cache bytecode in the user's cache folder if PyTorch's installation has none and cannot store any.

    Containers often set ``PYTHONDONTWRITEBYTECODE`` and install without ``__pycache__`` folders. Every process then compiles
    the 1,000 files of PyTorch again, which takes 3 s. A folder that the user chose (``PYTHONPYCACHEPREFIX``) stays.
    """
    torch = find_spec("torch")
    if torch is None or torch.origin is None or sys.pycache_prefix is not None:
        return
    compiled = Path(cache_from_source(torch.origin))
    gets_one = not sys.dont_write_bytecode and os.access(compiled.parents[1], os.W_OK)
    if not (compiled.exists() or gets_one):
        sys.pycache_prefix, sys.dont_write_bytecode = str(bytecode_folder()), False


def bytecode_folder() -> Path:
    """Return the folder for compiled Python code, ``aerial_gym/bytecode`` in the user's cache folder."""
    from aerial_gym.config.storage import user_cache_folder

    return user_cache_folder("bytecode")
