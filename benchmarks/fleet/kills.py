"""Tables after kills against those of an undisturbed run.

``python -m benchmarks.fleet.kills --logs DIR --robots FILE --out DIR``

Workers of Ray and the program itself are killed (SIGKILL) at random times. The program is started again until it ends. All
tables must then be equal to those of a run without kills, sorted by key, except ``written_at``.
"""

import random
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
import tyro

LONGEST_START_S = 120.0  # Until the workers run


@dataclass(frozen=True, kw_only=True)
class KillsCmd:
    """Compare tables after kills with those of an undisturbed run."""

    logs: str  # As for ``fleet run``
    robots: Path  # As for ``fleet run``
    out: Path  # Folder of both sets of tables
    worker_kills: int = 100
    driver_kills: int = 10
    pause_s: float = 2.0  # Mean time between kills
    workers: int = 2
    seed: int = 0

    def run(self) -> int:
        """Print whether the tables are equal; return the exit status."""
        command = [
            sys.executable,
            "-m",
            "aerial_gym",
            "fleet",
            "run",
            "--logs",
            self.logs,
            "--robots",
            str(self.robots),
        ]
        command += ["--workers", str(self.workers), "--out"]
        calm, disturbed = self.out / "calm", self.out / "disturbed"
        if psutil.Popen([*command, str(calm)]).wait():
            return 1
        kills = run_with_kills(
            [*command, str(disturbed)], self.worker_kills, self.driver_kills, random.Random(self.seed), self.pause_s
        )  # fmt: skip
        equal = table_contents(calm) == table_contents(disturbed)
        print(f"kills of workers: {kills[0]}, of the program: {kills[1]}; tables {'equal' if equal else 'NOT EQUAL'}")
        return int(not equal)


def run_with_kills(
    command: Sequence[str], worker_kills: int, driver_kills: int, draw: random.Random, pause_s: float
) -> tuple[int, int]:
    """Run a command with kills at random times until it ends; return the numbers of kills of workers and of the program.

    They fall short if the command ends earlier. Raises ``RuntimeError`` if it fails without having been killed.
    """
    shares = [worker_kills * k // (driver_kills + 1) for k in range(driver_kills + 2)]
    killed = drivers = 0
    for attempt in range(driver_kills + 1):
        driver = psutil.Popen(command)
        _wait_for_workers(driver)
        for _ in range(shares[attempt + 1] - shares[attempt]):
            time.sleep(draw.expovariate(1.0 / pause_s))
            if workers := _wait_for_workers(driver):
                _kill(draw.choice(workers))
                killed += 1
        time.sleep(draw.expovariate(1.0 / pause_s))
        if attempt < driver_kills and driver.poll() is None:
            family = driver.children(recursive=True)
            _kill(driver)
            drivers += 1
            psutil.wait_procs([driver, *family], timeout=30.0)  # the processes of Ray end with the program
        if driver.wait() and attempt == driver_kills:
            raise RuntimeError(f"the command fails without a kill: {' '.join(command)}")
    return killed, drivers


def worker_processes(driver: psutil.Popen) -> list[psutil.Process]:
    """Return the processes of Ray that run batches."""
    try:
        return [one for one in driver.children(recursive=True) if "MapWorker" in "".join(one.cmdline())]
    except psutil.NoSuchProcess:
        return []


def _wait_for_workers(driver: psutil.Popen) -> list[psutil.Process]:
    """Return the workers as soon as there are any; none if the program has ended."""
    start = time.monotonic()
    while driver.poll() is None and time.monotonic() - start < LONGEST_START_S:
        if workers := worker_processes(driver):
            return workers
        time.sleep(0.2)
    return []


def _kill(process: psutil.Process) -> None:
    try:
        process.kill()
    except psutil.NoSuchProcess:  # it has just ended
        return


def table_contents(out: Path) -> dict[str, list[str]]:
    """Return the rows of all tables as sorted texts, without ``written_at``."""
    from aerial_gym.fleet.schemas import SCHEMAS
    from aerial_gym.fleet.tables import FleetTables

    tables = FleetTables(out)
    return {
        name: sorted(
            repr(row) for row in tables.rows(name, [column for column in SCHEMAS[name].names if column != "written_at"])
        )
        for name in SCHEMAS
    }


if __name__ == "__main__":
    raise SystemExit(tyro.cli(KillsCmd, description=__doc__).run())
