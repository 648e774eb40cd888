"""Runner of a measurement in its own process, for this package and its peers alike."""

import os
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from aerial_gym.errors import ConfigError
from aerial_gym.registry import Registry

TIMEOUT_S = 900.0  # Longest time of one measurement, compilation included [s]

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class RunFailedError(Exception):
    """A process ended without a figure; the text is its last words."""


def run_process(
    python: str, arguments: Sequence[str], *, threads: int | None = None, folder: str | Path | None = None,
    variables: Mapping[str, str] | None = None,
) -> str:  # fmt: skip
    """Return the last line that a process writes to stdout.

    With ``threads`` it is pinned to as many cores, also its libraries. It runs in the temporary folder unless another is
    given, as some peers leave logs where they run.
    """
    cores = sorted(os.sched_getaffinity(0))[:threads]
    limits = {} if threads is None else dict.fromkeys(THREAD_VARIABLES, str(threads))
    try:
        done = subprocess.run(
            [python, *arguments], cwd=folder or tempfile.gettempdir(),
            env={**os.environ, **(variables or {}), **limits}, capture_output=True, encoding="utf-8",
            errors="replace", timeout=TIMEOUT_S, preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RunFailedError(str(error)) from None
    if done.returncode != 0:
        raise RunFailedError(_last_line(done.stderr) or f"exit status {done.returncode}")
    return _last_line(done.stdout)


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else ""


@dataclass(frozen=True, kw_only=True)
class PeerProgram:
    """Another program under the same workload."""

    needs: tuple[str, ...]  # Modules that must be importable
    install: str  # Distributions for pip
    devices: tuple[str, ...]  # `cpu`, `cuda`


Program = TypeVar("Program", bound=PeerProgram)


def interpreters(entries: Sequence[str], peers: Registry[Program], *, default: str, flag: str) -> dict[str, str]:
    """Return the interpreter of every peer; ``entries`` are ``NAME=PYTHON``, or ``PYTHON`` for all that are not named."""
    named: dict[str, str] = {}
    for entry in entries:
        name, equals, python = entry.rpartition("=")
        if not python:
            raise ConfigError(f"{flag} {entry!r}: must be PYTHON or NAME=PYTHON, an interpreter that has the peer")
        path = os.path.abspath(python) if os.sep in python else python
        if equals:
            peers.get(name)
            named[name] = path
        else:
            default = path
    return {name: named.get(name, default) for name in peers}


def absence_reason(name: str, peer: PeerProgram, python: str, device: str, *, flag: str) -> str | None:
    """Return the reason against measuring a peer, with the remedy; None if it can be measured."""
    if device not in peer.devices:
        return f"{name} is skipped: it runs on {', '.join(peer.devices)} only."
    code = f"import importlib.util as u, sys; sys.exit(not all(map(u.find_spec, {peer.needs!r})))"
    try:
        available = subprocess.run([python, "-c", code], capture_output=True).returncode == 0
    except OSError as error:
        return f"{name} is skipped: {python} does not start ({error})."
    if available:
        return None
    return (
        f"{name} is skipped: {python} does not have it. Install it there, or in an environment of its own: python -m venv "
        f"VENV && VENV/bin/pip install {peer.install}, then {flag} {name}=VENV/bin/python"
    )
