"""Detection of failures of the undeclared plant by ``aerial-gym watch`` and ``close-loop``, and their false alarms.

    python -m benchmarks.scores.score_failures --seeds 901 902 903 --quiet-seeds 951 952 --effects all

Each flight with a failure has one of random kind, rotor, size and time, and the small errors of every vehicle (nuisance).
Quiet flights have none; with ``--effects`` they have a large effect that the robot file does not declare. Logs are read row by
row as a stream, and whole as by ``close-loop``.
"""

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from aerial_gym.interop import one_thread
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.failures.flight_event import Failure as Found
from aerial_gym.sim2real.failures.flight_event import FailureFinder
from aerial_gym.sim2real.failures.watch import NAMED, SUSPECTED, Alarm, FlightWatch
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.wording import render_findings
from benchmarks.markdown import table
from benchmarks.undeclared import EFFECTS, CaseFiles, PlantFailure, make_case
from benchmarks.undeclared.surroundings import KINDS

SIZES = {"motor_failure": (0.0, 0.95), "weak_motor": (0.3, 0.95), "brown_out": (0.6, 0.95), "stuck_rotor": (1.0, 1.0)}
"""Ranges of ``scale``."""

RATE_HZ = 200
SOON_S = 10.0  # After its onset a failure should be named by then [s]

FLIGHT_S = 14.0
QUIET_S = 60.0

NAME_HEADS = (
    *("failure", "named right", f"of these within {SOON_S:g} s", "suspected after, median (largest) [s]"),
    *("named after, median (largest) [s]", "right in `close-loop`"),
)
ERROR_HEADS = ("failure", "size: median, largest", "inside", "onset [ms]: median, largest", "inside")


def draw_failure(kind: str, rng: np.random.Generator) -> PlantFailure:
    """Return a failure of a kind, 4 to 8 s into the flight; a brown-out lasts 0.3 to 1 s."""
    return PlantFailure(
        kind=kind,
        motor=int(rng.integers(1, 5)),
        scale=float(rng.uniform(*SIZES[kind])),
        time=float(np.round(rng.uniform(4.0, 8.0), 3)),
        duration=float(np.round(rng.uniform(0.3, 1.0), 3)) if kind == "brown_out" else np.inf,
    )


def score_vehicle(seed: int, folder: Path) -> Iterator[dict[str, object]]:
    """Yield the scores of one vehicle's flights with failures, two of each kind."""
    rng = np.random.default_rng([seed, 60])
    hidden = {f"train_{k + 1}": draw_failure(kind, rng) for k, kind in enumerate(KINDS * 2)}
    files = make_case(
        folder, effects={}, seed=seed, nuisance=True, num_train=len(hidden), num_test=0, duration_s=FLIGHT_S,
        rate_hz=RATE_HZ, failures=hidden,
    )  # fmt: skip
    truths = json.loads(files.truth.read_text())["failures"]
    for name, alarms, whole, log_s in watch_logs(files):
        truth, speed = hidden[name], truths[name].get("speed")
        yield {
            "seed": seed,
            "flight": name,
            "truth": truths[name],
            "log_s": log_s,
            "watch": {
                alarm.stage: score_finding(alarm.failure, truth, told=alarm.told_s, speed=speed) for alarm in alarms
            },
            "close_loop": None if whole is None else score_finding(whole, truth, speed=speed),
        }


def score_finding(
    result: Found, truth: PlantFailure, *, told: float | None = None, speed: float | None = None
) -> dict[str, object]:
    """Return the comparison of a finding with the truth; ``speed`` is that of a stuck rotor [rad/s]."""
    right = result.name == truth.kind and result.params.get("motor", truth.motor) == truth.motor
    row: dict[str, object] = {"name": result.name, "right": right, "log_odds": result.log_odds}
    if told is not None:
        row["delay_s"] = told - truth.time
    if right:
        sizes = {"time": truth.time, "scale": truth.scale, "speed": speed}
        sizes = {key: size for key, size in sizes.items() if key in result.params and size is not None}
        intervals = {key: result.interval[key] for key in sizes}
        errors = sizes | ({"duration": truth.duration} if "duration" in result.params else {})
        row["error"] = {key: result.params[key] - value for key, value in errors.items()}
        row["inside"] = {key: bool(low <= sizes[key] <= high) for key, (low, high) in intervals.items()}
    return row


def watch_logs(files: CaseFiles) -> Iterator[tuple[str, list[Alarm], Found | None, float]]:
    """Yield the name of each log, its alarms, the failure that the loop finds, and its duration [s]."""
    robot = robot_by_name(files.robot)
    finder = FailureFinder(robot)
    for path in files.train:
        header = path.read_text().splitlines()[0].split(",")
        watch, told = FlightWatch(robot, header, name=path.stem), []
        for row in np.loadtxt(path, delimiter=",", skiprows=1):
            told += watch.add(row)
        alarms = [*told, *watch.finish()]
        (flight,) = load_flights([path], robot, mapping=None, bandwidth=10.0)
        yield path.stem, alarms, finder.find_first_failure(flight), watch.watched_s


def false_alarms(seed: int, folder: Path, effect: str | None, flights: int, duration_s: float) -> dict[str, object]:
    """Return the false alarms of the watch and the closed loop in flights of one vehicle without failures."""
    effects = {effect: "large"} if effect else {}
    files = make_case(
        folder, effects=effects, seed=seed, nuisance=True, num_train=flights, num_test=0, duration_s=duration_s,
        rate_hz=RATE_HZ,
    )  # fmt: skip
    rows = list(watch_logs(files))
    return {
        "seed": seed,
        "hidden": effect or "nothing",
        "hours": sum(log_s for *_, log_s in rows) / 3600.0,
        "watch": [render_findings(alarm.as_mapping()) for _, alarms, _, _ in rows for alarm in alarms],
        "close_loop": [render_findings(results.as_mapping()) for _, _, results, _ in rows if results is not None],
    }


def failure_tables(fails: Sequence[dict], silent: Sequence[dict]) -> str:
    """Return the tables of a page: names and delays, errors of size and onset, and flights without a failure."""
    names, errors = [], []
    for kind in KINDS:
        rows = [row for row in fails if row["truth"]["kind"] == kind]
        if not rows:
            continue
        named = [row["watch"][NAMED] for row in rows if NAMED in row["watch"]]
        suspected = [row["watch"][SUSPECTED]["delay_s"] for row in rows if SUSPECTED in row["watch"]]
        right = [one for one in named if one["right"]]
        delays = [one["delay_s"] for one in right]
        size, unit = ("speed", " rad/s") if kind == "stuck_rotor" else ("scale", "")
        soon, count = sum(delay <= SOON_S for delay in delays), len(rows)
        loop = sum(bool(row["close_loop"] and row["close_loop"]["right"]) for row in rows)
        spreads = _median_and_largest(suspected), _median_and_largest(delays)
        names.append((f"`{kind}`", f"{len(right)} of {count}", soon, *spreads, f"{loop} of {count}"))
        errors.append((f"`{kind}`", *_error_cells(right, size, 1.0, unit), *_error_cells(right, "time", 1e3)))
    return "\n\n".join((table(NAME_HEADS, names), table(ERROR_HEADS, errors), _alarm_table(silent)))


def _alarm_table(silent: Sequence[dict]) -> str:
    """Return the table of flights without a failure."""
    lines = []
    plain, effects = ([r for r in silent if (r["hidden"] == "nothing") == wanted] for wanted in (True, False))
    for name, rows in (("nothing hidden", plain), (f"one of {len(effects)} large effects hidden", effects)):
        alarms = [(f"{one['name']} ({row['hidden']})", one["stage"]) for row in rows for one in row["watch"]]
        watch = ", ".join(text for text, stage in alarms if stage == SUSPECTED)
        loop = ", ".join(f"{one['name']} ({row['hidden']})" for row in rows for one in row["close_loop"])
        if rows:
            lines.append((name, f"{sum(row['hours'] for row in rows):.2f}", watch or "none", loop or "none"))
    return table(("flights without a failure", "hours", "alarms of `watch`", "alarms of `close-loop`"), lines)


def _median_and_largest(values: Sequence[float]) -> str:
    return f"{median(values):.2f} ({max(values):.2f})" if values else "-"


def _error_cells(rows: Sequence[dict], name: str, scale: float, unit: str = "") -> tuple[str, str]:
    """Return median and largest error of a parameter, and the number of intervals that contain its true value."""
    own = [row for row in rows if name in row["error"]]
    if not own:
        return "-", "-"
    inside = sum(row["inside"][name] for row in own)
    errors = [scale * abs(row["error"][name]) for row in own]
    middle, largest = (f"{error:.0f}" if error >= 100.0 else f"{error:.2g}" for error in (median(errors), max(errors)))
    return f"{middle}, {largest}{unit}", f"{inside} of {len(own)}"


@dataclass(frozen=True, kw_only=True)
class FailureScoreCmd:
    """Score the detection of failures."""

    seeds: tuple[int, ...] = ()  # Vehicles whose flights fail, eight flights each
    quiet_seeds: tuple[int, ...] = ()  # Vehicles without a failure
    quiet_flights: int = 30  # Flights of a minute of each of these
    effects: tuple[str, ...] = ()  # Also hide each of these, large: names, or all

    def run(self) -> None:
        """Score the flights and print the tables."""
        names = list(EFFECTS) if self.effects == ("all",) else self.effects
        fails, silent = list[dict](), list[dict]()
        console = Console(stderr=True)
        with tempfile.TemporaryDirectory() as temporary, one_thread():
            folder = Path(temporary)
            for seed in track(self.seeds, "vehicles that fail", console=console):
                fails += score_vehicle(seed, folder / f"fails_{seed}")
            for seed in track(self.quiet_seeds, "vehicles without a failure", console=console):
                silent.append(false_alarms(seed, folder / f"quiet_{seed}", None, self.quiet_flights, QUIET_S))
            for seed, name in enumerate(track(names, "vehicles with an effect", console=console), start=2000):
                silent.append(false_alarms(seed, folder / name, name, 4, FLIGHT_S))
        print(failure_tables(fails, silent))


if __name__ == "__main__":
    tyro.cli(FailureScoreCmd, description=__doc__).run()
