"""One process per measurement, ours and the peers' in turn; on the CPU all are pinned to the same cores."""

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from aerial_gym.workloads.process import RunFailedError, run
from benchmarks.peers.catalog import CASES, PEERS
from benchmarks.peers.table import Measurement

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Conditions common to all measurements."""

    num_envs: int
    threads: int
    device: str
    repeats: int
    repeat_time_s: float

    @property
    def core_count(self) -> int | None:
        """Cores to which a process is pinned; on a GPU the host's threads are left alone."""
        return self.threads if self.device == "cpu" else None

    def flags(self) -> list[str]:
        """Return the flags that our command and every peer understand."""
        return [f"--{name.replace('_', '-')}={value}" for name, value in vars(self).items()]


def _run(python: str, arguments: list[str], *, threads: int | None = None) -> str:
    """Run a process that finds this folder."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return run(python, arguments, threads=threads, variables={"PYTHONPATH": path})


def skip_reason(name: str, python: str, device: str) -> str | None:
    """Return a sentence that says why a peer cannot be measured, or None if it can."""
    peer = PEERS.get(name)
    if device not in peer.devices:
        return f"{name} is skipped: it runs on {', '.join(peer.devices)} only."
    try:
        _run(python, ["-c", f"import {peer.needs}"])
    except RunFailedError as error:
        return f"{name} is skipped: {python} cannot import it ({error})."
    return None


def measure_package(case: str, substeps: int, conditions: Conditions) -> Measurement:
    """Measure our physics in a process of its own."""
    command = ["-m", "aerial_gym.cli.main", "bench", "physics", "--json", f"--substeps={substeps}"]
    arguments = [*command, *conditions.flags(), *CASES[case]]
    figures = json.loads(_run(sys.executable, arguments, threads=conditions.core_count))
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
    figures = json.loads(_run(python, arguments, threads=conditions.core_count))
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
