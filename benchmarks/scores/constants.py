"""Which constants of the loop decide what it finds: each is halved and doubled, and the same flights are judged again.

    python -m benchmarks.scores.constants [--jobs 2] [--json] [--only LEAST_SCORE ...]

Ten cases of the undeclared plant in flights with the small errors that vehicles have (four of 8 s to train, two to test, 200
rows per second). A row is a constant that weighs evidence, says what flights can show, or ends a search; tolerances, and
numbers of the files and of the page, are not among them. It is changed in every module that has it from where it stands, not in
defaults that were evaluated before.
"""

import argparse
import importlib
import json
import pkgutil
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import aerial_gym.sim2real
from aerial_gym.interop import one_thread
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.in_memory import judge_flights
from aerial_gym.sim2real.logs.inputs import load_train_and_test
from benchmarks.undeclared import make_case
from benchmarks.undeclared.cases import CaseFiles

FLIGHTS = {"num_train": 4, "num_test": 2, "duration_s": 8.0, "rate_hz": 200, "nuisance": True}

CASES: tuple[dict[str, str], ...] = (
    {},
    {"com_offset": "small"},
    {"rotor_drag": "small"},
    {"weak_motor": "small"},
    {"motor_time_constant": "small"},
    {"constant_wind": "moderate"},
    {"payload_mass": "small", "actuation_delay": "small"},
    {"imu_bias": "small", "quadratic_drag": "small"},
    {"torque_ratio": "moderate", "rotor_inertia": "moderate"},
    {"unknown_position": "moderate"},
)
SEED = 3901

CONSTANTS = (
    "selection.scoring.LEAST_SCORE",
    "selection.choose.STEADY",
    "candidates.structure.LEAST_SHARE",
    "candidates.structure.SEGMENT_S",
    "candidates.structure.OWN_MOTION",
    "candidates.structure.LINE_WIDTH",
    "evidence.guard.FEWEST_PARTS",
    "least_squares.moments.BLOCK_S",
    "least_squares.moments.SHORTEST_BLOCK_S",
    "least_squares.moments.ENOUGH_BLOCKS",
    "least_squares.gauss_newton.FARTHEST_DEVIATION",
    "least_squares.gauss_newton.WEAK_PRIOR",
    "least_squares.gauss_newton.NOTHING_LEFT",
    "evidence.fitting.ENOUGH",
    "evidence.fitting.BROAD",
    "evidence.search.MOST_STARTS",
    "selection.view.FAR_BEHIND",
    "selection.climb.MOST_IN_VAIN",
    "selection.climb.MOST_RIVALS",
    "selection.climb.SAME_DEVIATION",
    "selection.climb.SETTLED",
)
"""Where they stand, in ``sim2real/identify``."""

FACTORS = (0.5, 2.0)


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What the loop says of a case."""

    verdict: str
    named: tuple[str, ...]


@contextmanager
def multiplied(place: str, factor: float) -> Iterator[float]:
    """Give every module of the loop that has a constant another value of it; yields the usual one."""
    home, name = place.rsplit(".", 1)
    for module in pkgutil.walk_packages(aerial_gym.sim2real.__path__, "aerial_gym.sim2real."):
        importlib.import_module(module.name)
    usual = getattr(sys.modules[f"aerial_gym.sim2real.identify.{home}"], name)
    having = [m for key, m in sys.modules.items() if key.startswith("aerial_gym.sim2real") and hasattr(m, name)]
    having = [module for module in having if getattr(module, name) == usual]
    for module in having:
        setattr(module, name, type(usual)(factor * usual))
    try:
        yield usual
    finally:
        for module in having:
            setattr(module, name, usual)


def answer(files: CaseFiles) -> Answer:
    """Return what the loop says of a case."""
    robot = robot_by_name(files.robot)
    with one_thread():
        train, test = load_train_and_test(robot, files.train, files.test, None, 10.0)
        verdict = judge_flights(robot, train, test, bandwidth=10.0).verdict
    return Answer(verdict=verdict.verdict, named=tuple(sorted(effect.name for effect in verdict.effects)))


def answers(changed: tuple[str, float], cases: list[CaseFiles]) -> tuple[float, list[Answer]]:
    """Return the usual value of a constant, and what the loop says with it multiplied."""
    with multiplied(*changed) as usual:
        return usual, [answer(files) for files in cases]


def row(name: str, usual: float, before: list[Answer], after: dict[float, list[Answer]]) -> dict[str, object]:
    """Return what a constant changes, by the cases' effects."""
    hidden = [" + ".join(case) or "nothing" for case in CASES]
    found: dict[str, object] = {"constant": name, "value": usual}
    for factor, there in after.items():
        found[f"times_{factor:g}"] = [
            {"hidden": what, "before": old.named, "after": new.named, "verdict": [old.verdict, new.verdict]}
            for what, old, new in zip(hidden, before, there, strict=True)
            if old != new
        ]
    return found


def line(found: dict[str, object]) -> str:
    """Return a row of the table."""
    cells = []
    for factor in FACTORS:
        changes = found[f"times_{factor:g}"]
        assert isinstance(changes, list)
        said = [
            f"{one['hidden']}: " + (", ".join(one["after"]) or "nothing") + f" (`{one['verdict'][1]}`)"
            for one in changes
        ]
        cells.append("; ".join(said) or "the same")
    return f"| `{found['constant']}` | {found['value']:g} | {cells[0]} | {cells[1]} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="one object a line")
    parser.add_argument("--only", nargs="+", default=CONSTANTS, choices=CONSTANTS, metavar="NAME")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(options.jobs) as pool:
        made = [
            pool.submit(make_case, Path(folder) / str(k), effects=case, seed=SEED + k, **FLIGHTS)
            for k, case in enumerate(CASES)
        ]
        cases = [case.result() for case in made]
        before = list(pool.map(answer, cases))
        if not options.json:
            for case, said in zip(CASES, before, strict=True):
                print(f"{' + '.join(case) or 'nothing'}: {', '.join(said.named) or 'nothing'} (`{said.verdict}`)")
            print("\n| constant | value | halved | doubled |\n| --- | --- | --- | --- |", flush=True)
        changed = [(name, factor) for name in options.only for factor in FACTORS]
        found = pool.map(partial(answers, cases=cases), changed)
        for name in options.only:
            pairs = [next(found) for _ in FACTORS]
            after = dict(zip(FACTORS, (one for _, one in pairs), strict=True))
            printed = row(name, pairs[0][0], before, after)
            print(json.dumps(printed) if options.json else line(printed), flush=True)


if __name__ == "__main__":
    main()
