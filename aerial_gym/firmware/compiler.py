"""The compiler of firmware, and the cache of built firmware. It is GPL: no source or binary of it is part of this package."""

import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

from aerial_gym.config.storage import user_cache_folder
from aerial_gym.errors import CapabilityError, MissingDependencyError

Progress = Callable[[str, float], None]
"""Receives the description of the work and the share that is done."""


def cache_folder() -> Path:
    """Return the folder of built firmware."""
    return user_cache_folder("firmware")


def require_programs(firmware: str, *names: str) -> None:
    """Raise ``MissingDependencyError`` with all programs that are missing."""
    if missing := [name for name in names if shutil.which(name) is None]:
        raise MissingDependencyError(
            f"sitl needs {' and '.join(missing)} to build {firmware}. Install them with the package manager of your system "
            f"(Debian: apt-get install {' '.join(missing)})"
        )


def compile_library(options: Sequence[str | Path], library: Path) -> None:
    """Compile a shared library; raise ``CapabilityError`` with the last lines of the compiler if that fails."""
    command = ["gcc", "-O2", "-shared", "-fPIC", "-w", *options, "-o", library]
    done = subprocess.run(command, cwd=library.parent, capture_output=True, text=True)
    if done.returncode:
        raise CapabilityError(f"{library.name} cannot be compiled: {last_lines(done.stderr)}")


def last_lines(text: str) -> str:
    """Return the last three lines of a program's messages, in one."""
    return " ".join(text.strip().splitlines()[-3:]) or "no message"
