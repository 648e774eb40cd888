"""Compare the verdict of the fleet's first pass with that of ``close-loop`` on cases of the undeclared plant.

    python -m benchmarks.fleet.agreement --cases 200 --loggers gps --seed 31000 --workers 2 --out DIR [--json]

Half of the cases are controls, with nothing hidden. The pass sums the evidence of the flights. It decides ``none`` where each
effect is clearly less probable than its absence and the test residual is within noise and tolerances. Every other case is
escalated: it goes to ``judge_flights`` on the same flights, which is ``close-loop``, so both verdicts agree by construction
and are not computed. For a case that the pass decides, ``close-loop`` runs as well. A case whose result by the same code is in
``--out`` is not flown again.
"""

import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from benchmarks.markdown import table, table_row
from benchmarks.scores.score_loggers import Logger, LoggerScoreCmd
from benchmarks.scores.score_undeclared import BANDWIDTH_HZ, Job, run_jobs
from benchmarks.undeclared import LOGGED, make_case

if TYPE_CHECKING:
    from aerial_gym.config.robot import RobotCfg
    from aerial_gym.sim2real.logs.flights import Flight

HEADS = ("hidden", "seed", "pass", "strongest effect", "channels above noise", "close-loop", "core-s per min")
NONE = ("none", "not shown")  # Verdicts of close-loop that name nothing and leave nothing unexplained


def compare_case(job: Job) -> dict[str, object]:
    """Return both verdicts on one case; an exception goes to ``error``."""
    from aerial_gym.interop import one_thread
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.sim2real.flight_evidence.evidence import FlightEvidence, flight_evidences
    from aerial_gym.sim2real.flight_evidence.verdict import verdict_of_sum
    from aerial_gym.sim2real.logs.flights import load_train_and_test
    from aerial_gym.sim2real.loop import judge_flights

    row: dict[str, object] = {"hidden": "+".join(job.hidden) or "nothing", "seed": job.seed, "job": asdict(job)}
    with tempfile.TemporaryDirectory() as folder:
        try:
            shared = {name: getattr(job, name) for name in ("seed", "features", "num_train", "num_test", "duration_s")}
            hidden = dict.fromkeys(job.hidden, job.size)
            files = make_case(folder, effects=hidden, nuisance=LOGGED, logger=job.logger, **shared)
            robot, logs = robot_by_name(files.robot), [*files.train, *files.test]
            flight_evidences(robot, logs[:1], bandwidth=BANDWIDTH_HZ)  # compiles
            start = time.process_time()
            evidences = flight_evidences(robot, logs, bandwidth=BANDWIDTH_HZ)
            used = time.process_time() - start
            flights = [one for one in evidences if isinstance(one, FlightEvidence)]
            verdict = verdict_of_sum(flights)
            inclusion = verdict.inclusion if verdict else {}
            row |= {
                "inclusion": {name: share for name, share in inclusion.items() if share > 1e-4},
                "named": list(verdict.effects) if verdict else [],
                "refused": len(evidences) - len(flights),
                "core_s_per_min": 60.0 * used / max(sum(one.duration_s for one in flights), 1e-9),
            }
            clear = verdict is not None and verdict.is_clearly_none and len(flights) == len(logs)
            with one_thread():
                loaded = load_train_and_test(robot, files.train, files.test, None, BANDWIDTH_HZ)
                row["above_noise"] = channels_above_noise(robot, *loaded) if clear else None
                if clear and not row["above_noise"]:
                    judged = judge_flights(robot, *loaded, bandwidth=BANDWIDTH_HZ).verdict
                    names = [one.name for one in judged.effects if one.material]
                    return {**row, "decided": True, "close_loop": judged.verdict, "close_loop_effects": names}
        except Exception as error:  # one bad case must not end a run of hours; it is counted, and not kept
            return {**row, "error": f"{type(error).__name__}: {error}"}
    return {**row, "decided": False}


def channels_above_noise(robot: "RobotCfg", train: Sequence["Flight"], test: Sequence["Flight"]) -> list[str]:
    """Return the channels whose test residual exceeds noise and tolerances, by the rule of ``find_residual_excess``.

    The deviations within the tolerances are those that fit the training flights best. Of each flight's mean, a possible
    offset is removed.
    """
    from aerial_gym.sim2real.flight_evidence.moments import WEIGHINGS
    from aerial_gym.sim2real.identify.candidates.nuisance import limits_of_flight_offsets
    from aerial_gym.sim2real.identify.least_squares.derivatives import rms_caused_by_tolerances, tolerance_jacobian
    from aerial_gym.sim2real.identify.least_squares.gauss_newton import linearise_at_params
    from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights
    from aerial_gym.sim2real.identify.stages import prepare_comparison
    from aerial_gym.sim2real.judge.random_wind.gusts import noise_floors_in_declared_wind
    from aerial_gym.sim2real.judge.residual_excess import (
        channel_rms,
        is_judged,
        is_material_excess,
        model_with_training_deviations,
    )
    from aerial_gym.sim2real.predict.noise_floor import rms_of_noise_floors
    from aerial_gym.sim2real.predict.tolerances import Tolerances

    setup = prepare_comparison(robot, train, test, bandwidth=BANDWIDTH_HZ, tolerances=Tolerances())
    floor = rms_of_noise_floors(noise_floors_in_declared_wind(setup.test, setup.params))
    tolerance = tolerance_jacobian(setup.train, setup.params)
    tolerated = rms_caused_by_tolerances(tolerance, robot.num_rotors)
    fit, model = linearise_at_params(setup.train, (), setup.params, tolerance), setup.params
    for _ in range(WEIGHINGS):
        weights = inverse_variance_weights(setup.train.residuals(model))
        model = model_with_training_deviations(setup.params, fit, weights.weight)
    most = limits_of_flight_offsets(setup.test, tolerated)
    left = [part - np.clip(part.mean(axis=0), -most, most) for part in setup.test.residuals(model)]
    excess = is_material_excess(channel_rms(left), floor, tolerated)
    judged = excess & is_judged(setup.channels, setup.flights)
    return [channel.name for channel, above in zip(setup.channels, judged, strict=True) if above]


def scores(rows: Sequence[dict]) -> dict[str, object]:
    """Return the agreement, the share of escalated cases and the cost of the pass."""
    done = [row for row in rows if "error" not in row]
    decided = [row for row in done if row["decided"]]
    wrong = [row for row in decided if row["close_loop"] not in NONE or row["close_loop_effects"]]
    controls = [row for row in done if row["hidden"] == "nothing"]
    return {
        "cases": len(done),
        "errors": len(rows) - len(done),
        "agreement": (len(done) - len(wrong)) / max(len(done), 1),
        "decided": len(decided),
        "decided_wrongly": len(wrong),
        "escalated_controls": sum(not row["decided"] for row in controls) / max(len(controls), 1),
        "core_s_per_min_median": float(np.median([row["core_s_per_min"] for row in done])) if done else None,
    }


@dataclass(frozen=True, kw_only=True)
class AgreementCmd:
    """Compare the verdict of the fleet's first pass with that of ``close-loop``."""

    cases: int = 200  # Half of them controls
    loggers: tuple[Logger, ...] = ("gps",)  # How flights are recorded
    seed: int = 31000  # Of the first case
    workers: int = 1  # Processes
    out: Path | None = None  # Folder that keeps the result of each case; an interrupted run continues
    json: bool = False  # One JSON object a line, the scores last

    def run(self) -> int:
        """Compare the cases and print the scores; return the exit status."""
        each = -(-self.cases // (2 * len(self.loggers)))
        jobs = LoggerScoreCmd(loggers=self.loggers, cases=each, seed=self.seed).plan_jobs()[: self.cases]
        console, rows = Console(stderr=True), list[dict]()
        compared = run_jobs(jobs, processes=self.workers, out=self.out, score=compare_case)
        if not self.json:
            print(table(HEADS), flush=True)
        for row in track(compared, "cases", len(jobs), console=console, disable=not console.is_terminal):
            rows.append(row)
            print(json.dumps(row) if self.json else table_row(_cells(row)), flush=True)
        print(json.dumps(scores(rows)) if self.json else json.dumps(scores(rows), indent=1))
        return 0


def _cells(row: dict) -> list[object]:
    """Return a row of the table of cases."""
    if "error" in row:
        return [row["hidden"], row["seed"], row["error"], *"----"]
    best = max(row["inclusion"], key=row["inclusion"].__getitem__, default="-")
    above = row["above_noise"]
    return [
        row["hidden"], row["seed"], "none" if row["decided"] else "escalated",
        f"{best} {row['inclusion'].get(best, 0.0):.3f}", "-" if above is None else ", ".join(above) or "none",
        row.get("close_loop", "-"), f"{row['core_s_per_min']:.2f}",
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(tyro.cli(AgreementCmd, description=__doc__).run())
