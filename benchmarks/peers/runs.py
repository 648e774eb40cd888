"""One process per measurement, ours and the peers' in turn; on the CPU all are pinned to the same cores."""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from aerial_gym.workloads.process import RunFailedError, run_process
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


def run_python(python: str, arguments: list[str], *, threads: int | None = None) -> str:
    """Run a process that finds this folder."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return run_process(python, arguments, threads=threads, variables={"PYTHONPATH": path})


def skip_reason(name: str, python: str, device: str) -> str | None:
    """Return a sentence that says why a peer cannot be measured, or None if it can."""
    peer = PEERS.get(name)
    if device not in peer.devices:
        return f"{name} is skipped: it runs on {', '.join(peer.devices)} only."
    try:
        run_python(python, ["-c", f"import {peer.needs}"])
    except RunFailedError as error:
        return f"{name} is skipped: {python} cannot import it ({error})."
    return None


def measure_case(case: str, owner: str | int, python: str, conditions: Conditions) -> Measurement:
    """Measure a peer, or our physics in a launch of ``owner`` substeps, in a process of its own."""
    if isinstance(owner, int):
        command = ["-m", "aerial_gym.cli.main", "bench", "physics", "--json", f"--substeps={owner}", *CASES[case]]
    else:
        command = ["-m", PEERS.get(owner).script, f"--case={case}"]
    figures = json.loads(run_python(python, [*command, *conditions.flags()], threads=conditions.core_count))
    shared = {"case": case, "rates": (figures["steps_per_s"],), "dt_s": figures["dt_s"]}
    if isinstance(owner, str):
        return Measurement(**shared, name=owner, substeps=None, version=figures["version"], call=figures["call"])
    version = f"{figures['versions']['aerial_gym']}, {figures['commit']}, warp {figures['versions']['warp']}"
    return Measurement(**shared, name="aerial_gym", substeps=owner, version=version, call=str(owner))


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
