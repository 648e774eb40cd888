"""Score ``aerial-gym preflight``: vehicles of the undeclared plant with one fault each, and vehicles without one.

    python -m benchmarks.preflight --faults 200 --clean 60 --seed 30000 --workers 16 --out DIR [--json]

A fault counts as right if it is named first, its number is within the limit, and nothing else is contradicted. The truth holds
the small errors of every vehicle and logger. A vehicle whose result is in ``--out`` is not flown again.
"""

import json
import shutil
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import track

from aerial_gym.errors import AerialGymError
from aerial_gym.interop import one_thread
from aerial_gym.sim2real.preflight.check import preflight
from aerial_gym.sim2real.preflight.link import TrainingLink
from aerial_gym.sim2real.preflight.ranges import TrainingConditions
from benchmarks.markdown import table
from benchmarks.preflight.faults import DRAWS, POLICY_HZ
from benchmarks.preflight.flights import fly_vehicle
from benchmarks.preflight.score import judge

TRAINING = TrainingConditions(link=TrainingLink(rate=POLICY_HZ))


@dataclass(frozen=True, kw_only=True)
class PreflightVehicle:
    """One vehicle to fly and to judge."""

    kind: str  # Of its fault; empty without one
    seed: int

    @property
    def name(self) -> str:
        """Name of its result."""
        return f"{self.kind or 'clean'}_{self.seed}"


def score_vehicle(vehicle: PreflightVehicle, out: Path | None) -> dict:
    """Return the score of a vehicle, from ``out`` if it is there."""
    kept = None if out is None else out / f"{vehicle.name}.json"
    if kept is not None and kept.exists():
        return json.loads(kept.read_text())
    folder, start = Path(tempfile.mkdtemp()), time.perf_counter()
    try:
        files = fly_vehicle(folder, vehicle.kind, vehicle.seed)
        flown = time.perf_counter()
        row: dict = {"kind": vehicle.kind, "seed": vehicle.seed, "fly_s": flown - start}
        truth = json.loads(files.truth.read_text())
        try:
            with one_thread():
                result = preflight(files.robot, files.log, training=TRAINING)
            row |= judge(result, truth)
        except AerialGymError as error:
            row |= {"right": False, "named": [], "error": str(error)}
        row["judge_s"] = time.perf_counter() - flown
    finally:
        shutil.rmtree(folder)
    if kept is not None:
        temporary = kept.with_suffix(".part")
        temporary.write_text(json.dumps(row))
        temporary.replace(kept)
    return row


@dataclass(frozen=True, kw_only=True)
class PreflightScoreCmd:
    """Score ``aerial-gym preflight`` on vehicles of the undeclared plant."""

    faults: int = 200  # Vehicles with one fault each, all kinds in turn
    clean: int = 60  # Vehicles without a fault
    seed: int = 1000  # Of the first vehicle; each has the next one
    kinds: tuple[str, ...] = ()  # Only these kinds of faults
    workers: int = 1  # Processes
    out: Path | None = None  # Folder that keeps the result of each vehicle; an interrupted run continues
    json: bool = False  # One JSON object a vehicle, the scores last

    def vehicles(self) -> list[PreflightVehicle]:
        """Return the vehicles: those with faults, then those without."""
        kinds = self.kinds or tuple(DRAWS)
        names = [kinds[k % len(kinds)] for k in range(self.faults)] + [""] * self.clean
        return [PreflightVehicle(kind=kind, seed=self.seed + k) for k, kind in enumerate(names)]

    def rows(self) -> Iterator[dict]:
        """Yield the score of each vehicle when it is done."""
        vehicles = self.vehicles()
        if self.workers == 1:
            yield from (score_vehicle(one, self.out) for one in vehicles)
            return
        with ProcessPoolExecutor(self.workers) as pool:
            for done in as_completed([pool.submit(score_vehicle, one, self.out) for one in vehicles]):
                yield done.result()

    def run(self) -> int:
        """Score and print; return 0, or 1 if a limit is missed."""
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
        rows, console = list[dict](), Console(stderr=True)
        for row in track(self.rows(), "vehicles", self.faults + self.clean, console=console):
            rows.append(row)
            if self.json:
                print(json.dumps(row), flush=True)
        faults, clean = ([row for row in rows if bool(row["kind"]) is wanted] for wanted in (True, False))
        right, invented = sum(row["right"] for row in faults), sum(not row["right"] for row in clean)
        scores = {"right": [right, len(faults)], "invented": [invented, len(clean)]}
        print(json.dumps(scores) if self.json else score_text(rows, scores))
        return int(right < 0.95 * len(faults) or invented > max(1.0, len(clean) / 60.0))


def score_text(rows: list[dict], scores: dict[str, list[int]]) -> str:
    """Return the scores of each kind as markdown."""
    lines = []
    for kind in sorted({row["kind"] for row in rows}):
        own = [row for row in rows if row["kind"] == kind]
        wrong_names = sorted(
            {", ".join(row["named"]) or row.get("error", "nothing") for row in own if not row["right"]}
        )
        errors = [abs(row["error_share"]) for row in own if row.get("error_share") is not None]
        worst = f"{max(errors):.2f}" if errors else "-"
        lines.append(
            (kind or "none", f"{sum(row['right'] for row in own)} of {len(own)}", worst, "; ".join(wrong_names))
        )
    times = [f"{name} {sum(row[f'{name}_s'] for row in rows) / len(rows):.1f} s" for name in ("fly", "judge")]
    heads = ("fault", "right", "largest error per limit", "named where wrong")
    parts = [row["intervals"] for row in rows if "intervals" in row]
    scores = scores | {"true values in their intervals": [sum(part[k] for part in parts) for k in (0, 1)]}
    share = [f"{name}: {hits} of {count}" for name, (hits, count) in scores.items()]
    return "\n\n".join((table(heads, lines), "; ".join((*share, *times))))


if __name__ == "__main__":
    raise SystemExit(tyro.cli(PreflightScoreCmd, description=__doc__).run())
