"""Scores of ``close-loop`` on flights of two vehicles of the undeclared plant.

    python -m benchmarks.undeclared --pairs --cases 8 --seed SEED --workers 16 --out DIR [--json]

Each kind of ``benchmarks.undeclared.pairs.HIDDEN`` gets ``--cases`` cases, each with its own seed. A case whose result by the
same code is in ``--out`` is not flown again. Each result is one of these:

- right: what is hidden is named, and nothing else. For gusts also whether both vehicles feel the same, for an effect on one
  vehicle also on which one, and for clocks that differ by how much, within 0.05 s. A control names nothing and is not open.
- ambiguous: the verdict leaves it open, and the hidden effect is among the candidates.
- false: a name that is not there and is not tied with the hidden effect, the wrong vehicle, the wrong statement on gusts, or
  a verdict ``explained`` where the clocks differ.
- missed: anything else.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

from rich.console import Console
from rich.progress import track

from aerial_gym.errors import ConfigError
from aerial_gym.workloads.measure import require_at_least
from benchmarks.markdown import table
from benchmarks.scores.score_undeclared import BANDWIDTH_HZ, code_digest, judge_verdict, run_jobs
from benchmarks.undeclared.effects import cause_names
from benchmarks.undeclared.pairs import HIDDEN, make_pair_case

RESULTS = ("right", "ambiguous", "missed", "false", "error")
CLOCK_ERROR = 0.05  # Largest error of an offset that counts as right [s]
SEPARATE, SHARED = "gusts_separate", "gusts_shared"


@dataclass(frozen=True, kw_only=True)
class PairJob:
    """One case to score."""

    kind: str
    seed: int
    duration_s: float = 16.0
    rate_hz: int = 400

    @property
    def key(self) -> str:
        """Name of the result file: the case, and a digest of its fields and of the judged code."""
        digest = sha256((json.dumps(asdict(self), sort_keys=True) + code_digest()).encode()).hexdigest()[:8]
        return f"pair_{self.kind.replace(' ', '_')}_{self.seed}_{digest}"


@dataclass(frozen=True, kw_only=True)
class PairScoreCmd:
    """Score ``close-loop`` on flights of two vehicles."""

    pairs: bool = True  # Two vehicles in each flight
    cases: int = 8  # Of each kind
    seed: int = 24000  # Of the first case of each kind; each case has the next one
    kinds: tuple[str, ...] = ()  # Only these
    workers: int = 1  # Processes
    out: Path | None = None  # Folder that keeps the result of each case; an interrupted run continues
    json: bool = False  # One JSON object a line, the scores last

    def run(self) -> int:
        """Score the cases and print the scores; return the exit status."""
        require_at_least(1, cases=self.cases, workers=self.workers)
        kinds = self.kinds or tuple(HIDDEN)
        if unknown := [kind for kind in kinds if kind not in HIDDEN]:
            raise ConfigError(f"--kinds {', '.join(unknown)}: take some of {', '.join(HIDDEN)}")
        jobs = [PairJob(kind=kind, seed=self.seed + i) for i in range(self.cases) for kind in kinds]
        console, rows = Console(stderr=True), []
        scored = run_jobs(jobs, processes=self.workers, out=self.out, score=score_pair)
        for row in track(scored, "cases", len(jobs), console=console):
            rows.append(row)
            if self.json:
                print(json.dumps(row), flush=True)
        print(json.dumps(count_results(rows)) if self.json else results_text(rows))
        return 0


def score_pair(job: PairJob) -> dict[str, object]:
    """Return the closed loop's result for one case; an exception goes to ``error``."""
    from aerial_gym.interop import one_thread
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.sim2real.logs.flights import load_train_and_test
    from aerial_gym.sim2real.logs.pairs import pair_logs
    from aerial_gym.sim2real.loop import judge_flights
    from aerial_gym.sim2real.report.verdict_json import verdict_json

    row: dict[str, object] = asdict(job)
    with tempfile.TemporaryDirectory() as folder:
        try:
            files = make_pair_case(
                Path(folder), job.kind, seed=job.seed, duration_s=job.duration_s, rate_hz=job.rate_hz
            )
            robot = robot_by_name(files.robot)
            with one_thread():
                pairs = pair_logs(files.pairs)
                flights = load_train_and_test(robot, files.train, files.test, None, BANDWIDTH_HZ, pairs=pairs)
                verdict = verdict_json(judge_flights(robot, *flights, bandwidth=BANDWIDTH_HZ).verdict)
        except Exception as error:  # one bad case must not end a run of hours; it is counted, and not kept
            return {**row, "error": f"{type(error).__name__}: {error}", "result": "error"}
    effects = files.truth["effects"]
    assert isinstance(effects, dict)
    judged = judge_verdict(verdict, effects)
    codes = (
        "gusts_undecided",
        SHARED,
        SEPARATE,
        "vehicle_alone",
        "clock_contradicted",
        "clock_confirmed",
    )
    findings = verdict["findings"]
    assert isinstance(findings, list)
    said = [one for one in findings if one["code"] in codes]
    result = pair_result(job.kind, list(effects), float(str(files.truth["clock_s"])), judged, said)
    return {**row, "effects": list(effects), "truth": effects, **judged, "said": said, "result": result}


def pair_result(
    kind: str, hidden: Sequence[str], clock: float, judged: Mapping[str, object], said: Sequence[Mapping]
) -> str:
    """Return one of ``RESULTS`` for a judged verdict; ``clock``: hidden offset of the second log [s]."""
    causes = {cause for name in hidden for cause in cause_names(name)}
    named, candidates, ties = (judged[key] for key in ("material", "candidates", "ties"))
    assert isinstance(named, list)
    assert isinstance(candidates, list)
    assert isinstance(ties, dict)
    strangers = {name for name in named if name not in (*causes, "learned_residual") and not set(ties[name]) & causes}
    codes, verdict = {str(one["code"]) for one in said}, judged["verdict"]
    offsets = [one["values"]["offset_s"] for one in said if one["code"] == "clock_contradicted"]
    if kind == "control":
        if strangers or offsets:
            return "false"
        return "right" if verdict in ("none", "not shown") else "ambiguous"
    if kind == "clocks apart":
        if offsets:
            return "right" if all(abs(one - clock) < CLOCK_ERROR for one in offsets) else "false"
        return "false" if strangers or verdict == "explained" else "missed"
    if kind == "effect on one":
        alone = {one["subject"]: one["values"] for one in said if one["code"] == "vehicle_alone"}
        return _result_on_one(causes, verdict, alone, candidates, bool(strangers or offsets))
    if strangers or offsets or codes & ({SHARED} if kind == "gusts on each" else {SEPARATE}):
        return "false"
    if kind.startswith("gusts") and named and not codes & {SHARED, SEPARATE}:
        return "ambiguous"
    if verdict == "ambiguous":
        return "ambiguous" if causes & {*named, *candidates} else "false"
    return "right" if verdict == "explained" and causes <= {*judged["named"]} else "missed"  # type: ignore[misc]


def _result_on_one(
    causes: set[str], verdict: object, alone: Mapping[str, Mapping], candidates: Sequence[str], wrong: bool
) -> str:
    """Return the result for an effect that only the second vehicle has."""
    named = {vehicle: set(one["effects"]) for vehicle, one in alone.items() if one["verdict"] == "explained"}
    if named.get("first") or named.get("second", causes) - causes or (verdict == "explained"):
        return "false"
    if wrong:
        return "false"
    if named.get("second"):
        return "right"
    return "ambiguous" if causes & set(candidates) else "missed"


def count_results(rows: Sequence[Mapping]) -> dict[str, dict[str, int]]:
    """Return the number of cases with each result, by kind."""
    kinds = dict.fromkeys(str(row["kind"]) for row in rows)
    return {
        kind: {name: sum(row["result"] == name for row in rows if row["kind"] == kind) for name in RESULTS}
        for kind in kinds
    }


def results_text(rows: Sequence[Mapping]) -> str:
    """Return the results of each kind, and each case that is not right, as markdown."""
    counts = [(kind, *numbers.values()) for kind, numbers in count_results(rows).items()]
    cases = [
        (row["kind"], row["seed"], row["result"], row.get("error") or row["verdict"], ", ".join(row.get("material", ())) or "-",
         "; ".join(f"{one['code']} {one['subject']}" for one in row.get("said", ())) or "-")
        for row in sorted(rows, key=lambda one: (one["kind"], one["seed"])) if row["result"] != "right"
    ]  # fmt: skip
    heads = ("kind", "seed", "result", "verdict", "named", "findings")
    return f"{table(('hidden', *RESULTS), counts)}\n\n{table(heads, cases)}"
