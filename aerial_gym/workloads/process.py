"""Runner of a measurement in its own process, for this package and its peers alike."""

import os
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

TIMEOUT_S = 900.0  # Longest time of one measurement, compilation included [s]

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class RunFailedError(Exception):
    """A process ended without a figure; the text is its last words."""


def run_process(
    python: str,
    arguments: Sequence[str],
    *,
    threads: int | None = None,
    folder: str | Path | None = None,
    variables: Mapping[str, str] | None = None,
) -> str:
    """Return the last line that a process writes to stdout.

    With ``threads`` it is pinned to as many cores, also its libraries. It runs in the temporary folder unless another is
    given, as some peers leave logs where they run.
    """
    cores = sorted(os.sched_getaffinity(0))[:threads]
    limits = {} if threads is None else dict.fromkeys(THREAD_VARIABLES, str(threads))
    try:
        done = subprocess.run(
            [python, *arguments],
            cwd=folder or tempfile.gettempdir(),
            env={**os.environ, **(variables or {}), **limits},
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=TIMEOUT_S,
            preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RunFailedError(str(error)) from None
    if done.returncode != 0:
        raise RunFailedError(_last_line(done.stderr) or f"exit status {done.returncode}")
    return _last_line(done.stdout)


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else ""
