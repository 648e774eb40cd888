"""Speed of fleet analysis on one machine, and the time of a larger fleet on several, from these measurements.

``python -m benchmarks.fleet.speed --logs DIR --robots FILE --out DIR [--json]``: ``fleet run`` in one process without Ray, then
with one and with two workers of Ray, each into new tables. Nothing else may run on the machine.
"""

import json
import resource
import shutil
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil
import tyro

from aerial_gym.fleet.engine import Engine, ray_engine, run_serially
from aerial_gym.fleet.run import FleetRun, run_fleet
from aerial_gym.fleet.sources import LogStore
from aerial_gym.fleet.tables import FleetTables
from aerial_gym.fleet.vehicles import load_fleet
from benchmarks.markdown import table

MEMORY_EVERY_S = 0.5
CORE_S_PER_MINUTE = 60.0


@dataclass(frozen=True, kw_only=True)
class RunSpeed:
    """Measurements of one run."""

    way: str
    workers: int
    flights: int
    vehicles: int
    minutes: float  # Of flight
    start_s: float  # Until the engine is ready
    flights_s: float  # Of pass 1, with the commits
    vehicles_s: float  # Of pass 2
    table_bytes: int
    memory_half: int  # Largest memory of all processes in the first half of pass 1 [bytes]
    memory: int  # Largest memory of all processes [bytes]

    @property
    def flight_s(self) -> float:
        """Return the time of a flight in pass 1 [s]."""
        return self.flights_s / self.flights


@dataclass(frozen=True, kw_only=True)
class SpeedCmd:
    """Measure the speed of fleet analysis."""

    logs: str  # As for ``fleet run``
    robots: Path  # As for ``fleet run``
    out: Path  # Folder of the tables, which are deleted
    flights: float = 1e6  # Of the estimate
    flights_per_vehicle: float = 100.0  # Of the estimate
    nodes: tuple[int, ...] = (1, 10, 100)  # Of the estimate
    cores: int = 16  # Of a node
    json: bool = False  # Print one JSON object a line

    def run(self) -> int:
        """Print the measurements and the estimate; return the exit status."""
        ways: list[tuple[str, int, Callable[[], AbstractContextManager[Engine]]]] = [
            ("one process", 1, lambda: nullcontext(run_serially)),
            ("Ray", 1, lambda: ray_engine(1, None)),
            ("Ray", 2, lambda: ray_engine(2, None)),
        ]
        runs = [self._measure(*way) for way in ways]
        if self.json:
            for one in runs:
                print(json.dumps(asdict(one)))
            return 0
        print(table(("way", "workers", "start [s]", "pass 1 [s]", "a flight [s]", "pass 2 [s]", "memory [MB]"), [
            (one.way, one.workers, f"{one.start_s:.1f}", f"{one.flights_s:.1f}", f"{one.flight_s:.3f}",
             f"{one.vehicles_s:.1f}", f"{one.memory_half / 1e6:.0f} in the first half, {one.memory / 1e6:.0f}")
            for one in runs
        ]))  # fmt: skip
        alone, ray, two = runs
        print(f"core-seconds per minute of flight: {alone.flights_s / alone.minutes:.2f}")
        print(
            f"overhead of Ray: {ray.flight_s / alone.flight_s - 1.0:+.1%}; two workers: {ray.flight_s / two.flight_s:.2f} times"
        )
        print(f"tables: {alone.table_bytes / alone.flights / 1e3:.0f} kB per flight")
        self._print_estimate(ray)
        return 0

    def _measure(self, way: str, workers: int, start: Callable[[], AbstractContextManager[Engine]]) -> RunSpeed:
        out = self.out / f"{way.replace(' ', '_')}_{workers}"
        shutil.rmtree(out, ignore_errors=True)
        request = FleetRun(logs=LogStore(url=self.logs), fleet=load_fleet(self.robots, None), out=out)
        marks, begun = dict[str, float](), time.perf_counter()

        def report(stage: str, share: float) -> None:
            marks[stage.partition(" ")[0]] = time.perf_counter()
            memory.half = memory.half if stage.startswith("flights") and share > 0.5 else memory.most

        with start() as engine, MemoryWatch() as memory:
            ready = time.perf_counter()
            summary = run_fleet(request, engine, report)
            end = time.perf_counter()
        tables = FleetTables(out)
        minutes = sum(row["duration_s"] for row in tables.rows("flights", ("duration_s",))) / 60.0
        return RunSpeed(
            way=way, workers=workers, flights=summary.new, vehicles=summary.vehicles, minutes=minutes,
            start_s=ready - begun, flights_s=marks["flights"] - ready, vehicles_s=end - marks["flights"],
            table_bytes=sum(file.stat().st_size for file in out.rglob("*.parquet")), memory_half=memory.half,
            memory=memory.most,
        )  # fmt: skip

    def _print_estimate(self, ray: RunSpeed) -> None:
        """Print the time of a larger fleet with its terms, from a run of Ray with one worker."""
        vehicles, own = self.flights / self.flights_per_vehicle, ray.vehicles_s / ray.flights
        store = self.flights * ray.table_bytes / ray.flights
        print(
            f"\n{self.flights:.0e} flights of {60.0 * ray.minutes / ray.flights:.0f} s, {vehicles:.0e} vehicles, nodes with "
            f"{self.cores} cores: flights x {ray.flight_s:.3f} s / cores + flights x {own:.4f} s / cores + start "
            f"{ray.start_s:.0f} s; tables {store / 1e9:.0f} GB"
        )
        rows = []
        for nodes in self.nodes:
            first, second = (self.flights * one / (nodes * self.cores) for one in (ray.flight_s, own))
            rows.append((nodes, *(f"{one / 3600.0:.2f}" for one in (first, second, first + second + ray.start_s))))
        print(table(("nodes", "pass 1 [h]", "pass 2 [h]", "total [h]"), rows))


class MemoryWatch:
    """Largest memory of this process and its children, watched while it is entered."""

    def __init__(self) -> None:
        self.most = self.half = 0
        self._ended = threading.Event()
        self._watch = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> "MemoryWatch":
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._watch.join()
        self.most = max(self.most, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)

    def _look(self) -> None:
        process = psutil.Process()
        while not self._ended.wait(MEMORY_EVERY_S):
            total = 0
            for one in (process, *process.children(recursive=True)):
                try:
                    total += one.memory_info().rss
                except psutil.NoSuchProcess:
                    continue
            self.most = max(self.most, total)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(SpeedCmd, description=__doc__).run())
