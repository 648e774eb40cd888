"""Scores of ``close-loop`` on measured flights.

    python -m benchmarks.scores.score_measured --data DATA [--sets arpl swarm] [--jobs 4] [--json]

DATA has a folder for each collection of flights; none is part of this repository (docs/results/measured.md names the sources).
A set trains on some flights of a collection and is judged on others; ``_back`` exchanges them. Each row has the verdict, the
named effects with parameters, probabilities and rivals, residuals and rollout errors of the test flights before and after,
elapsed and processor time, and peak memory. With one job, predictions use all cores.
"""

import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import tyro

from benchmarks.scores.score_undeclared import run_in_processes

Files = Callable[[Path, Path], list[Path]]  # Function from the folder of all data, and a folder to write to, to logs


@dataclass(frozen=True, kw_only=True)
class FlightSplit:
    """Flights to train and to judge on."""

    robot: str
    mapping: str
    bandwidth: float  # [Hz]
    train: Files
    test: Files


def write_log_part(log: Path, folder: Path, number: int, parts: int = 2, *, rows_per_mean: int = 1) -> Path:
    """Write a part of a log as means of some rows each, and return the file."""
    import numpy as np
    import pandas as pd

    table = pd.read_csv(log)
    rows = table[number * len(table) // parts : (number + 1) * len(table) // parts]
    path = folder / f"{number}_of_{parts}_{log.name}"
    rows.groupby(np.arange(len(rows)) // rows_per_mean).mean().to_csv(path, index=False)
    return path


def arpl_halves(number: int, *more: str) -> Files:
    """Return the first or second halves of two logs of ARPL, and some whole ones, as means of four rows (126 Hz)."""

    def files(data: Path, folder: Path) -> list[Path]:
        parts = [(name, number, 2) for name in ("log10", "log15")] + [(name, 0, 1) for name in more]
        logs = data / "arpl_crazyflie_imu"
        return [write_log_part(logs / f"{name}.csv", folder, *part, rows_per_mean=4) for name, *part in parts]

    return files


def pair_half(number: int, *more: str) -> Files:
    """Return one half of the log of a vehicle below another one, beside that of the other, and whole logs of Neural-Swarm."""

    def files(data: Path, folder: Path) -> list[Path]:
        logs = data / "neural_swarm"
        _, below = (write_log_part(logs / f"swap_ss_00_{vehicle}.csv", folder, number) for vehicle in ("cf51", "cf50"))
        return [below, *(logs / f"{name}.csv" for name in more)]

    return files


def log_finder(collection: str, *names: str) -> Files:
    """Return logs of a collection by name; patterns give all that fit, in order."""
    return lambda data, _folder: [path for name in names for path in sorted((data / collection).glob(f"{name}.csv"))]


def every_other(collection: str, *patterns: str) -> Files:
    """Return every other one of the logs that fit some patterns."""
    complete = log_finder(collection, *patterns)
    return lambda data, folder: sorted(complete(data, folder))[::2]


def both_ways(name: str, **fields) -> dict[str, FlightSplit]:
    """Return a set, and the same with test and training flights exchanged."""
    back = fields | {"train": fields["test"], "test": fields["train"]}
    return {name: FlightSplit(**fields), f"{name}_back": FlightSplit(**back)}


IDSIA = ("idsia_nanodrone", "square_*", "random*", "multisine_*")
MELONS = log_finder("idsia_nanodrone", "melon_*")


def all_flights_but_half(data: Path, folder: Path) -> list[Path]:
    """Return 13 flights of IDSIA and the first half of the last one."""
    *whole, last = [*log_finder(*IDSIA)(data, folder), *MELONS(data, folder)]
    return [*whole, write_log_part(last, folder, 0)]


def last_half(data: Path, folder: Path) -> list[Path]:
    """Return the second half of the last flight of IDSIA."""
    return [write_log_part(MELONS(data, folder)[-1], folder, 1)]


ARPL = {"robot": "crazyflie_2x_arpl", "mapping": "arpl_crazyflie_imu", "bandwidth": 10.0, "test": arpl_halves(1)}
BRUSHLESS = {"robot": "crazyflie_21_brushless", "mapping": "idsia_nanodrone", "bandwidth": 10.0, "test": MELONS}

SETS: dict[str, FlightSplit] = {
    "arpl": FlightSplit(**ARPL, train=arpl_halves(0)),
    "arpl_yaw": FlightSplit(**ARPL, train=arpl_halves(0, "log16_a")),
    "idsia": FlightSplit(**BRUSHLESS, train=log_finder(*IDSIA)),
    "idsia_half": FlightSplit(**BRUSHLESS, train=every_other(*IDSIA)),
    "idsia_all": FlightSplit(**BRUSHLESS | {"train": all_flights_but_half, "test": last_half}),
    **both_ways(
        "neural_swarm",
        robot="crazyflie_21",
        mapping="neural_swarm",
        bandwidth=8.0,
        train=log_finder("neural_swarm", "groundflight_cf50_a", "takeoff_cf52", "groundflight_cf101_parrot"),
        test=log_finder("neural_swarm", "takeoff_cf50"),
    ),
    "neural_swarm_pair": FlightSplit(
        robot="crazyflie_21",
        mapping="neural_swarm",
        bandwidth=8.0,
        train=pair_half(0, "groundflight_cf50_a", "takeoff_cf52"),
        test=pair_half(1),
    ),
    **both_ways(
        "nanobench",
        robot="crazyflie_21",
        mapping="nanobench_cf21",
        bandwidth=4.0,
        train=log_finder(
            "nanobench_cf21", "B2_circle_fast_rep1", "B3_figure8_fast_rep1", "B7_oval_fast_rep1", "B8_star_medium_rep1"
        ),
        test=log_finder("nanobench_cf21", "B9_trefoil_fast_rep1", "B5_helix_fast_rep1"),
    ),
    **both_ways(
        "neural_fly",
        robot="neural_fly_quad",
        mapping="neural_fly",
        bandwidth=5.0,
        train=log_finder("neural_fly", "NF_nowind", "baseline_35wind", "indi_35wind", "baseline_100wind", "NF_100wind"),
        test=log_finder("neural_fly", "NF_70wind", "baseline_70wind", "indi_70wind"),
    ),
}


def score_set(name: str, data: Path) -> dict[str, object]:
    """Return the closed loop's result for a data set; an exception goes to ``error``."""
    from aerial_gym.interop import one_thread
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.sim2real.logs.flights import load_train_and_test
    from aerial_gym.sim2real.loop import judge_flights
    from aerial_gym.sim2real.report.verdict_json import verdict_json
    from aerial_gym.sim2real.wording import render_findings

    result = SETS[name]
    with tempfile.TemporaryDirectory() as folder, one_thread():
        try:
            train, test = (files(data, Path(folder)) for files in (result.train, result.test))
            robot = robot_by_name(result.robot)
            flights = load_train_and_test(robot, train, test, result.mapping, result.bandwidth)
            start, begin = time.process_time(), time.monotonic()
            judged = judge_flights(robot, *flights, bandwidth=result.bandwidth)
        except Exception as error:  # one bad set must not end the others; it is counted
            return {"set": name, "error": f"{type(error).__name__}: {error}"}
    verdict = verdict_json(judged.verdict)
    keys = ("verdict", "reason", "effects", "candidates", "inclusion", "before", "after", "test_flights", "structure")
    return {
        "set": name,
        **{key: verdict[key] for key in keys},
        "refused": render_findings(judged.selection.refused),
        "processor_s": round(time.process_time() - start, 1),
        "elapsed_s": round(time.monotonic() - begin, 1),
        "most_memory_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
    }


def row_text(row: dict) -> list[str]:
    """Return a readable row: the named effects and the change of the residuals."""
    if "error" in row:
        return [f"{row['set']}: {row['error']}"]
    result = [
        f"{row['set']}: {row['verdict']} ({row['elapsed_s']} s, {row['processor_s']} s of processor time, "
        f"{row['most_memory_gb']} GB at most)"
    ]
    for effect in row["effects"]:
        values = [
            f"{key} {value:.4g} ± {1.96 * effect['std'][key]:.2g}" if key in effect["std"] else f"{key} {value:.4g}"
            for key, value in effect["params"].items()
        ]
        rivals = effect.get("ties", ())  # a residual model has none
        ties = f", may as well be {' or '.join(rivals)}" if rivals else ""
        result.append(f"  {effect['name']}: {', '.join(values)}; confidence {effect['confidence']:.4g}{ties}")
    for kind, axes in row["before"].items():
        if kind in ("specific_force", "angular_acceleration"):
            parts = [
                f"{axis} {one['rms']:.3g} -> {row['after'][kind][axis]['rms']:.3g}"
                for axis, one in axes.items()
                if isinstance(one, dict)
            ]
            result.append(f"  {kind.replace('_', ' ')}: {', '.join(parts)}")
    worse = [f"{name} {one['rises']:+.0%}" for name, one in row["test_flights"].items() if one["state"] == "worse"]
    return [*result, f"  worse: {', '.join(worse) or 'nothing'}"]


@dataclass(frozen=True, kw_only=True)
class FlightScoreCmd:
    """Score ``close-loop`` on measured flights."""

    data: Path  # Folder with a folder for each collection
    sets: tuple[str, ...] = tuple(SETS)  # Names of ``SETS``
    jobs: int = 1  # Processes
    json: bool = False  # One JSON object a line

    def run(self) -> int:
        """Score the sets; return the exit status."""
        if not self.data.is_dir():
            print(f"{self.data}: no such folder", file=sys.stderr)
            return 2
        if unknown := sorted(set(self.sets) - set(SETS)):
            print(f"no set {unknown}. Known: {', '.join(SETS)}", file=sys.stderr)
            return 2
        failed = False
        for _, row in run_in_processes(partial(score_set, data=self.data), self.sets, self.jobs, cases_of_each=1):
            failed |= "error" in row
            print(json.dumps(row) if self.json else "\n".join(row_text(row)), flush=True)
        return int(failed)


if __name__ == "__main__":
    sys.exit(tyro.cli(FlightScoreCmd, description=__doc__).run())
