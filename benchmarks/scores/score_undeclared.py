"""Scores of ``close-loop`` on flights of the undeclared plant.

    python -m benchmarks.scores.score_undeclared --seeds 101 102 [--nuisance | --tracked | --logged] [--json]
    python -m benchmarks.scores.score_undeclared --seeds 101 102 --effects all --sizes small moderate large --unknown \
        --pairs com_offset+constant_wind --jobs 8 --out out/undeclared

Without --effects the first six effects are hidden: one case for each effect, size and seed. Controls have nothing hidden, one
for each kind of flight. A case whose result is in --out is not flown again. Each row has the verdict, the named effects, the
largest error of a parameter in standard deviations, and the largest residual on the test flights as a multiple of its noise
floor, before and after. A name that the test flights do not show to be material counts as not named. The plant shares no code
with the package.
"""

import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Literal, Protocol, TypeVar

import tyro
from rich.console import Console
from rich.progress import track

from benchmarks.markdown import table, table_row
from benchmarks.scores.score_table import result_tables, right_line
from benchmarks.undeclared import EFFECTS, LOGGED, TRACKED, UNKNOWN, make_case

Item = TypeVar("Item")
Result = TypeVar("Result")


class JobWithKey(Protocol):
    """A case to score whose result is kept in a file."""

    @property
    def key(self) -> str:
        """Name of the result file."""
        ...


ScoredJob = TypeVar("ScoredJob", bound=JobWithKey)

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run_in_processes(
    call: Callable[[Item], Result], items: Iterable[Item], processes: int, *, cases_of_each: int | None = None
) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result as they come; a process ends after ``cases_of_each`` cases, if given."""
    if processes > 1:
        os.environ.update(dict.fromkeys(THREADS, "1"))  # before the processes start
    context = get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, max_tasks_per_child=cases_of_each) as pool:
        try:
            futures = {pool.submit(call, item): item for item in items}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


CLASSIC = tuple(EFFECTS)[:6]  # Scored where no --effects are given
BANDWIDTH_HZ = 10.0  # Residuals are compared below it: the default of `close-loop`, whose page is not drawn here

HOVER = ("", "com_offset", "thrust_coefficient", "payload_mass", "weak_motor", "rotor_drag")
"""Hidden effects of cases whose training flights only hover, none among them; test flights move."""

HEADS = ("hidden", "size", "seed", "verdict", "named", "right", "worst z", "before / floor", "after / floor")
Size = Literal["small", "moderate", "large"]


@cache
def code_digest() -> str:
    """Return a digest of plant, physics and identification: results of other code are not taken over."""
    root, digest = Path(__file__).parents[2], sha256()
    for folder in ("benchmarks/undeclared", "aerial_gym/physics", "aerial_gym/sim2real"):
        for path in sorted((root / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True, kw_only=True)
class Job:
    """One case to score."""

    hidden: tuple[str, ...]  # Names of the effects; none: a control
    size: str
    seed: int
    nuisance: bool
    tracked: bool
    logged: bool
    features: tuple[str, ...] = ()  # Of the flights, beside those that the effects need
    num_train: int = 4
    num_test: int = 3
    duration_s: float = 16.0
    logger: str = ""  # One of ``LOGGERS``; the truth then has the evidence that the log can show

    @property
    def key(self) -> str:
        """Name of the result file: the case, and a digest of all its fields and of the judged code."""
        parts = ("+".join(self.hidden).replace("/", "-") or "nothing", *self.features, *filter(None, [self.logger]))
        label = "-".join(parts)
        digest = sha256((json.dumps(asdict(self), sort_keys=True) + code_digest()).encode()).hexdigest()[:8]
        return f"{label}_{self.size if self.hidden else 'none'}_{self.seed}_{digest}"


def score_case(job: Job) -> dict[str, object]:
    """Return the closed loop's result for one case; an exception goes to ``error``."""
    from aerial_gym.interop import one_thread
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.sim2real.logs.flights import load_train_and_test
    from aerial_gym.sim2real.loop import judge_flights
    from aerial_gym.sim2real.report.verdict_json import verdict_json

    row: dict[str, object] = {**asdict(job), "hidden": "+".join(job.hidden) or "nothing", "effects": list(job.hidden)}
    with tempfile.TemporaryDirectory() as name:
        folder, start = Path(name), time.monotonic()
        try:
            files = make_case(
                folder / "case",
                effects=dict.fromkeys(job.hidden, job.size),
                seed=job.seed,
                nuisance=LOGGED if job.logged else TRACKED if job.tracked else job.nuisance,
                features=job.features,
                num_train=job.num_train,
                num_test=job.num_test,
                duration_s=job.duration_s,
                logger=job.logger,
                evidence=bool(job.logger),
            )
            flown = time.monotonic()
            robot = robot_by_name(files.robot)
            with one_thread():
                flights = load_train_and_test(robot, files.train, files.test, None, BANDWIDTH_HZ)
                verdict = verdict_json(judge_flights(robot, *flights, bandwidth=BANDWIDTH_HZ).verdict)
        except Exception as error:  # one bad case must not end a run of hours; it is counted, and not kept
            return {**row, "error": f"{type(error).__name__}: {error}", "verdict": "error", "named": [], "right": False}
        hidden = json.loads(files.truth.read_text())
        truth = hidden["effects"]
        times = {"fly_s": flown - start, "loop_s": time.monotonic() - flown}
    evidence = {"evidence": hidden["evidence"]} if job.logger else {}
    return {**row, **judge_verdict(verdict, truth), "truth": truth, **evidence, **times}


def judge_verdict(verdict: dict, truth: dict[str, dict[str, float]]) -> dict[str, object]:
    """Return the judgement of a verdict against the hidden effects and their parameters."""
    named = {e["name"]: e for e in verdict["effects"]}
    parameters = []
    for effect in (name for name in named if name in truth):
        params, stds = _shift_wind_height(truth[effect], named[effect]["params"], named[effect]["std"])
        parameters += [
            {"effect": effect, "name": key, "true": true, "value": params[key], "std": stds[key]}
            for key, true in truth[effect].items()
            if stds.get(key)
        ]
    claims = [name for name, one in named.items() if one["material"]]  # Not those that test flights do not show
    distances = [abs(p["value"] - p["true"]) / p["std"] for p in parameters]
    expected = ("explained",) if truth else ("none", "not shown")
    return {
        "verdict": verdict["verdict"],
        "named": list(named),
        "material": claims,
        "ties": {name: list(named[name].get("ties", ())) for name in claims},
        "candidates": list(verdict.get("candidates", [])),
        "not_testable": list(verdict.get("not_testable", [])),
        "structure": verdict.get("structure"),
        "right": set(claims) == set(truth) and verdict["verdict"] in expected,
        "judgement": _judgement(claims, list(truth), verdict),
        "worst_z": max(distances, default=0.0),
        "inside": sum(z < 1.96 for z in distances),
        "intervals": len(distances),
        "parameters": parameters,
        "before_over_floor": _over_floor(verdict["before"]),
        "after_over_floor": _over_floor(verdict["after"]),
    }


def _shift_wind_height(
    truth: dict[str, float], params: dict[str, float], std: dict[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return parameters and their spread with a sheared wind at the reference height of the truth; others as they are."""
    if "z_ref" not in truth:
        return params, std
    factor = (truth["z_ref"] / params["z_ref"]) ** params["exponent"]
    slope = abs(math.log(truth["z_ref"] / params["z_ref"]))
    moved, spread = dict(params), dict(std)
    for key in "xy":
        moved[key] = factor * params[key]
        spread[key] = factor * math.hypot(std[key], params[key] * slope * std["exponent"])
    return moved, spread


def _judgement(named: list[str], hidden: list[str], verdict: dict) -> str:
    """Return right, near, wrong or missed; quiet or false alarm for a control; given a name or held back if unknown."""
    # Near: no more named than the hidden effects and those that the package lists as confused with them; or an ambiguous
    # verdict whose candidates have the hidden effects.
    library = [name for name in named if name != "learned_residual"]
    if not hidden:
        return "false alarm" if library else "quiet"
    if any(name in UNKNOWN for name in hidden):
        return "given a name" if set(library) - set(hidden) else "held back"
    if set(named) == set(hidden) and verdict["verdict"] == "explained":
        return "right"
    if verdict["verdict"] == "ambiguous" and set(hidden) <= {*library, *verdict.get("candidates", ())}:
        return "near"
    if not library:
        return "missed"
    return "near" if set(library) <= {*hidden, *(c for name in hidden for c in _confusions(name))} else "wrong"


def _confusions(name: str) -> tuple[str, ...]:
    """Return the effects that the package declares as confusable with one; empty for an unknown effect."""
    from aerial_gym.errors import UnknownNameError
    from aerial_gym.physics.effects import EFFECTS as LIBRARY

    try:
        return tuple(LIBRARY.get(name).confused_with)
    except UnknownNameError:
        return ()


def _over_floor(model: dict[str, dict[str, dict[str, float]]]) -> float:
    """Return the largest residual of force or angular acceleration as a multiple of its noise floor."""
    return max(
        entry["rms"] / entry["noise_floor"]
        for kind in ("specific_force", "angular_acceleration", "rotor_speed")
        for axis, entry in model.get(kind, {}).items()
        if axis != "unit" and "noise_floor" in entry
    )


def run_jobs(
    jobs: Sequence[ScoredJob],
    *,
    processes: int,
    out: Path | None,
    score: Callable[[ScoredJob], dict[str, object]],
) -> Iterator[dict[str, object]]:
    """Yield the rows as they come: those kept in ``out`` first, then the others, which are kept as they come."""
    todo = []
    for job in jobs:
        kept = out / f"{job.key}.json" if out else None
        if kept is not None and kept.is_file():
            yield json.loads(kept.read_text())
        else:
            todo.append(job)
    scored = ((job, score(job)) for job in todo) if processes == 1 else run_in_processes(score, todo, processes)
    for job, row in scored:
        if out is not None and "error" not in row:  # a failed case is to be tried again
            out.mkdir(parents=True, exist_ok=True)
            part = out / f"{job.key}.json.part"
            part.write_text(json.dumps(row, indent=1) + "\n")
            part.replace(out / f"{job.key}.json")
        yield row


@dataclass(frozen=True, kw_only=True)
class ScoreCmd:
    """Score ``close-loop`` on flights of the undeclared plant."""

    seeds: tuple[int, ...]  # One case for each effect, size and seed
    sizes: tuple[Size, ...] = ("moderate",)
    effects: tuple[str, ...] = CLASSIC  # Names, or all
    pairs: tuple[str, ...] = ()  # Effects at once, as A+B
    unknown: bool = False  # Also causes outside the package
    nuisance: bool = False  # Small errors everywhere, as real vehicles have
    tracked: bool = False  # These, markers that are aligned by eye, a bias of each flight's own
    logged: bool = False  # These, every sensor late, an accelerometer with a scale and a place
    hover: bool = False  # Also cases whose training flights only hover
    controls: bool = False  # Only the controls of these cases
    num_train: int = 4  # Training flights
    num_test: int = 3  # Test flights
    duration_s: float = 16.0  # Length of each flight [s]
    jobs: int = 1  # Processes
    out: Path | None = None  # Folder that keeps the result of each case; an interrupted run continues
    json: bool = False  # One JSON object a line

    def plan_jobs(self) -> list[Job]:
        """Return the cases that the flags ask for, seed by seed; controls first."""
        single = (*(EFFECTS if self.effects == ("all",) else self.effects), *(UNKNOWN if self.unknown else ()))
        cases = [tuple(name.split("+")) for name in (*single, *self.pairs)]
        known = {**EFFECTS, **UNKNOWN}
        if missing := sorted({name for case in cases for name in case} - set(known)):
            raise ValueError(f"no effect {missing}. Known: all, {', '.join(known)}")
        flights = sorted({tuple(sorted({f for name in case for f in known[name].needs})) for case in cases} | {()})
        names = ("nuisance", "tracked", "logged", "num_train", "num_test", "duration_s")
        shared = {name: getattr(self, name) for name in names}
        jobs = []
        for seed in self.seeds:
            jobs += [Job(hidden=(), size="moderate", seed=seed, features=f, **shared) for f in flights]
            if self.controls:
                continue
            jobs += [Job(hidden=case, size=size, seed=seed, **shared) for case in cases for size in self.sizes]
            for name in HOVER if self.hover else ():
                hidden = (name,) if name else ()
                jobs.append(Job(hidden=hidden, size="moderate", seed=seed, features=("hover",), **shared))
        return jobs

    def run(self) -> int:
        """Score the cases and print a table and the totals; return the exit status."""
        try:
            jobs = self.plan_jobs()
        except ValueError as error:
            print(error, file=sys.stderr)
            return 2
        if not self.json:
            print(table(HEADS), flush=True)
        rows = []
        console, scored = Console(stderr=True), run_jobs(jobs, processes=self.jobs, out=self.out, score=score_case)
        for row in track(scored, "cases", len(jobs), console=console, disable=not console.is_terminal):
            rows.append(row)
            print(json.dumps(row) if self.json else table_row(_table_cells(row)), flush=True)
        order = {(job.hidden, job.size, job.seed, job.features): i for i, job in enumerate(jobs)}
        rows.sort(key=lambda r: order[tuple(r["effects"]), r["size"], r["seed"], tuple(r["features"])])
        if not self.json:
            print(f"\n{right_line(rows)}\n\n{result_tables(rows)}")
        return 0


def _table_cells(row: dict) -> list[object]:
    """Return a row of the table of cases."""
    hidden = row["hidden"] if row["effects"] else " ".join(("nothing", *row["features"]))
    start = [hidden, row["size"] if row["effects"] else "-", row["seed"], row["verdict"]]
    if "error" in row:
        return [*start, row["error"], False, "-", "-", "-"]
    numbers = [f"{row[name]:.2f}" for name in ("worst_z", "before_over_floor", "after_over_floor")]
    return [*start, ", ".join(row["named"]) or "-", row["right"], *numbers]


if __name__ == "__main__":
    sys.exit(tyro.cli(ScoreCmd, description=__doc__).run())
