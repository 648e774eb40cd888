"""One process per measurement, ours and the peers' in turn; on the CPU all are pinned to the same cores."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.peers.catalog import CASES, PEERS
from benchmarks.peers.table import Measurement

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 600.0
"""Longest time of one measurement, compilation of a peer included [s]."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What all measurements share."""

    num_envs: int
    threads: int
    device: str
    repeats: int
    repeat_time_s: float

    @property
    def pinned(self) -> int | None:
        """Cores to which a process is pinned; on a GPU the host's threads are left alone."""
        return self.threads if self.device == "cpu" else None

    def flags(self) -> list[str]:
        """Return the flags that our command and every peer understand."""
        return [f"--{name.replace('_', '-')}={value}" for name, value in vars(self).items()]


class RunFailedError(Exception):
    """A process ended without a figure; the text is its last words."""


def run(python: str, arguments: list[str], *, threads: int | None = None) -> str:
    """Return the last line that a process writes to stdout; with ``threads`` it is pinned to so many cores.

    Raises:
        RunFailedError: If it fails, takes too long or cannot be started.
    """
    cores = sorted(os.sched_getaffinity(0))[:threads]
    limits = {} if threads is None else dict.fromkeys(THREAD_VARIABLES, str(threads))
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    try:
        done = subprocess.run(
            [python, *arguments],
            cwd=tempfile.gettempdir(),  # some peers leave logs where they run
            env={**os.environ, "PYTHONPATH": path, **limits},
            capture_output=True,
            text=True,
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


def why_skipped(name: str, python: str, device: str) -> str | None:
    """Return a sentence that says why a peer cannot be measured, or None if it can."""
    peer = PEERS.get(name)
    if device not in peer.devices:
        return f"{name} is skipped: it runs on {', '.join(peer.devices)} only."
    try:
        run(python, ["-c", f"import {peer.needs}"])
    except RunFailedError as error:
        return f"{name} is skipped: {python} cannot import it ({error})."
    return None


def ours(case: str, substeps: int, conditions: Conditions) -> Measurement:
    """Measure our physics in a process of its own."""
    command = ["-m", "aerial_gym.cli.main", "bench", "physics", "--json", f"--substeps={substeps}"]
    arguments = [*command, *conditions.flags(), *CASES[case]]
    figures = json.loads(run(sys.executable, arguments, threads=conditions.pinned))
    version = f"{figures['versions']['aerial_gym']}, {figures['commit']}, warp {figures['versions']['warp']}"
    return Measurement(
        name="aerial_gym",
        case=case,
        substeps=substeps,
        rates=(figures["steps_per_s"],),
        version=version,
        dt_s=figures["dt_s"],
        call=str(substeps),
    )


def peers(name: str, python: str, case: str, conditions: Conditions) -> Measurement:
    """Measure a peer in a process of its own."""
    arguments = ["-m", PEERS.get(name).script, f"--case={case}", *conditions.flags()]
    figures = json.loads(run(python, arguments, threads=conditions.pinned))
    return Measurement(
        name=name,
        case=case,
        substeps=None,
        rates=(figures["steps_per_s"],),
        version=figures["version"],
        dt_s=figures["dt_s"],
        call=figures["call"],
    )


def schedule(case: str, names: list[str], substeps: tuple[int, ...]) -> Iterator[str | int]:
    """Give the order of a round: ours (as its number of substeps) and a peer's name in turn, each at least once.

    Nothing where no peer can do the case: there is nothing to compare.
    """
    able = [name for name in names if case in PEERS.get(name).cases]
    if not able:
        return
    for i in range(max(len(able), len(substeps))):
        yield substeps[i % len(substeps)]
        if i < len(able):
            yield able[i]
