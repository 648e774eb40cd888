"""The peers and cases, one process per measurement of a peer or ours in turn, and the ratios of their medians.

On the CPU all processes are pinned to the same cores.
"""

import json
import os
import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from aerial_gym.registry import Registry
from aerial_gym.workloads.measure import PeerProgram, run_process

ROOT = Path(__file__).parents[2]

CASES: dict[str, tuple[str, ...]] = {
    "plant": ("--integrator", "euler", "--controller", "rotor_speed_control"),
    "rk4": ("--integrator", "rk4", "--controller", "rotor_speed_control"),
    "attitude": ("--integrator", "euler", "--controller", "lee_attitude_control"),
}
"""Our options by case; rotor lag and linear drag are in all of them."""


@dataclass(frozen=True, kw_only=True)
class Peer(PeerProgram):
    """Another simulator; ``benchmarks/peers/peer_NAME.py`` runs it."""

    cases: tuple[str, ...]  # What it can do of `CASES`


PEERS: Registry[Peer] = Registry("peer")

for _name, _needs, _install, _cases, _devices in (
    ("crazyflow", "crazyflow.sim", "crazyflow", ("plant", "rk4", "attitude"), ("cpu", "cuda")),
    ("l2f", "l2f", "l2f", ("rk4",), ("cpu",)),
    ("hyperdrone", "hyperdrone.dynamics", "hyperdrone", ("rk4",), ("cpu", "cuda")),
    ("rotorpy", "rotorpy.vehicles", "rotorpy torch torchdiffeq roma tqdm", ("rk4",), ("cpu", "cuda")),
    ("mujoco", "mujoco.rollout", "mujoco", ("plant", "rk4"), ("cpu",)),
):
    PEERS.register(_name, Peer(needs=(_needs,), install=_install, cases=_cases, devices=_devices))


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Figures of one simulator in one case."""

    name: str  # Simulator: aerial_gym or a peer
    case: str  # plant, rk4 or attitude
    substeps: int | None  # Substeps in one launch of ours; None for a peer
    rates: tuple[float, ...]  # Steps per second, all vehicles together, one figure a round
    version: str  # Versions of what ran
    dt_s: float  # Length of a step [s]
    call: str  # How many steps one call makes, and what fuses them

    @property
    def steps_per_s(self) -> float:
        """Median of the rounds."""
        return statistics.median(self.rates)


def run_python(python: str, arguments: list[str], *, threads: int | None = None) -> str:
    """Run a process that finds this folder."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return run_process(python, arguments, threads=threads, variables={"PYTHONPATH": path})


def measure_case(case: str, owner: str | int, python: str, flags: Sequence[str], *, threads: int | None) -> Measurement:
    """Measure a peer, or our physics in a launch of ``owner`` substeps, in a process of its own with these flags."""
    if isinstance(owner, int):
        command = ["-m", "aerial_gym.cli.main", "bench", "physics", "--json", f"--substeps={owner}", *CASES[case]]
    else:
        command = ["-m", f"benchmarks.peers.peer_{owner}", f"--case={case}"]
    figures = json.loads(run_python(python, [*command, *flags], threads=threads))
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


def gather_rounds(measurements: Iterable[Measurement]) -> list[Measurement]:
    """Return one measurement per simulator, case and substeps, with the figures of all rounds."""
    result: dict[tuple[str, str, int | None], Measurement] = {}
    for new in measurements:
        key = (new.name, new.case, new.substeps)
        result[key] = replace(new, rates=result[key].rates + new.rates) if key in result else new
    return list(result.values())


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Ours against one peer in one case."""

    peer: Measurement
    package: Measurement

    @property
    def ratio(self) -> float:
        """Our rate over the peer's; above 1 ours is faster."""
        return self.package.steps_per_s / self.peer.steps_per_s

    def as_mapping(self) -> dict[str, object]:
        """Return the row as plain data."""
        row: dict[str, object] = {"case": self.peer.case, "peer": self.peer.name}
        for side, given in (("peer", self.peer), ("ours", self.package)):
            row |= {f"{side}_{name}": getattr(given, name) for name in ("version", "call", "dt_s", "steps_per_s")}
            row[f"{side}_rounds"] = given.rates
        return row | {"ratio": self.ratio}


def ratios(measurements: Sequence[Measurement]) -> list[Ratio]:
    """Return a row for every peer's case and every number of substeps of ours in that case, in order of the cases."""
    gathered = gather_rounds(measurements)
    own = [m for m in gathered if m.substeps is not None]
    peers = [m for m in gathered if m.substeps is None]
    return [Ratio(peer=peer, package=run) for peer in peers for run in own if run.case == peer.case]
