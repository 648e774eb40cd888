"""``python -m benchmarks.peers``: run every installed peer and ours in turn, and print the ratios."""

import json
import sys
from dataclasses import dataclass
from typing import Literal

import tyro

from aerial_gym.errors import AerialGymError, ConfigError
from aerial_gym.interop import resolve_device
from aerial_gym.workloads import measure
from benchmarks.markdown import table
from benchmarks.peers.runs import CASES, PEERS, Measurement, Ratio, measure_case, ratios, schedule


@dataclass(frozen=True, kw_only=True)
class PeersCmd:
    """Compare the physics with that of other simulators, all measured in this run on this machine."""

    cases: tuple[str, ...] = ("plant", "rk4", "attitude")
    """plant: rotor speeds, lag, drag, Euler; rk4: the same with RK4; attitude: plant with an attitude controller."""

    num_envs: int = 1024  # Vehicles side by side; L2F knows powers of two only
    threads: int = 1  # Threads of every process, and on the CPU the cores to which it is pinned
    device: Literal["cpu", "cuda"] = "cpu"  # Where all run; peers without a GPU version are skipped on cuda
    substeps: tuple[int, ...] = (1, 10)  # Our substeps in one launch; compare peers that fuse steps with more than 1
    peer: tuple[str, ...] = ()  # NAME=PYTHON, or PYTHON for all: the interpreter of a peer; this one by default
    rounds: int = 3  # How often everything is measured, in turn; the median counts
    repeats: int = 3  # Figures of one process
    repeat_time_s: float = 0.5  # About how long each is measured [s]
    json: bool = False  # Print one JSON object a line

    def run(self) -> int:
        """Measure and print; return the exit status: 1 if a measurement failed."""
        pythons = measure.interpreters(self.peer, PEERS, default=sys.executable, flag="--peer")
        for case in self.cases:
            if case not in CASES:
                raise ConfigError(f"no case {case!r}. Known: {', '.join(CASES)}")
        device, beside = measure.device_name(resolve_device(self.device)), measure.provenance()
        skipped = {
            name: measure.absence_reason(name, PEERS.get(name), pythons[name], self.device, flag="--peer")
            for name in PEERS
        }
        for sentence in filter(None, skipped.values()):
            print(sentence, file=sys.stderr)
        result, failed = self._measure({name: pythons[name] for name, why in skipped.items() if why is None})
        rows = ratios(result)
        if self.json:
            shared = {"num_envs": self.num_envs, "threads": self.threads, "device": device, **beside}
            for row in rows:
                print(json.dumps({**row.as_mapping(), **shared}, ensure_ascii=False))
        else:
            print(f"{device}, {self.num_envs} vehicles, {self.threads} threads, load {beside['load1']}\n")
            print(ratios_table(rows))
        return 1 if failed else 0

    def _measure(self, pythons: dict[str, str]) -> tuple[list[Measurement], bool]:
        """Return the measurements of all rounds, and whether one failed; report progress on stderr."""
        shared = ("num_envs", "threads", "device", "repeats", "repeat_time_s")
        flags = [f"--{name.replace('_', '-')}={getattr(self, name)}" for name in shared]
        cores = self.threads if self.device == "cpu" else None  # on a GPU the host's threads are left alone
        broken, result = set(), []
        turn_order = [(case, owner) for case in self.cases for owner in schedule(case, list(pythons), self.substeps)]
        for turn in range(self.rounds):
            for case, owner in turn_order:
                if (owner, case) in broken:
                    continue
                try:
                    python = pythons.get(str(owner), sys.executable)
                    new = measure_case(case, owner, python, flags, threads=cores)
                except measure.RunFailedError as error:
                    broken.add((owner, case))
                    print(f"{owner} failed in case {case}: {error}", file=sys.stderr)
                    continue
                result.append(new)
                done = f"round {turn + 1}/{self.rounds}  {case:<9}{new.name:<11}"
                print(f"{done}{new.call} a call: {measure.format_value(new.steps_per_s)} steps/s", file=sys.stderr)
        return result, bool(broken)


def ratios_table(rows: list[Ratio]) -> str:
    """Return the table for people: a line per peer and case, two columns per number of substeps of ours."""
    lines: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        start = [row.peer.case, row.peer.name, row.peer.call, measure.format_value(row.peer.steps_per_s)]
        line = lines.setdefault((row.peer.case, row.peer.name), start)
        line += [measure.format_value(row.package.steps_per_s), f"{row.ratio:.2f}"]
    calls = dict.fromkeys(row.package.call for row in rows)
    own = [head for call in calls for head in (f"ours, {call} a call", "ratio")]
    return table(("case", "peer", "steps a call", "steps/s", *own), lines.values())


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(PeersCmd, prog="python -m benchmarks.peers").run())
    except AerialGymError as error:
        print(f"benchmarks.peers: {error}", file=sys.stderr)
        sys.exit(2)
