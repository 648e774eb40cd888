"""Success on a hidden vehicle with Betaflight in the loop, of policies trained with and without ``train --for-real``.

    python -m benchmarks.for_real --seeds 5 --workers 2 --out DIR            # everything
    python -m benchmarks.for_real --seeds 5 --out DIR --phase train          # without firmware; on a GPU

Phases: ``log`` flies the owner's log and compares it with the robot file (its result is kept in this folder), ``train`` trains,
``fly`` flies all policies, and ``parts`` those of the first seed with each part of the hidden vehicle alone. What is in
``--out`` is not repeated; a training that was interrupted begins again.
"""

import json
import shutil
import sys
import time
from collections.abc import Collection
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from math import hypot, sqrt
from pathlib import Path
from statistics import NormalDist, mean
from typing import Literal

import tyro

from aerial_gym.cli.preflight import PreflightCmd
from aerial_gym.cli.train import TrainCmd
from aerial_gym.config.storage import write_atomic
from aerial_gym.for_real.plan import plan_training
from aerial_gym.interop import one_thread
from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.rl_training.policies.load import load_policy
from aerial_gym.rl_training.policy_task import PolicyTask
from aerial_gym.sim2real.preflight.result_file import read_result
from benchmarks.for_real.vehicle import FOLDER, PARTS, TASK, fly_log, make_hidden_task
from benchmarks.learning.policies import write_weights
from benchmarks.markdown import table

ROBOT, RESULT = "racing_quadrotor", FOLDER / "preflight.json"
ARMS = ("with", "without")
LOG_SEED, FLIGHT_SEED = 6700, 1_000_003  # Of the owner's log, and of the flights that are judged
LIMIT = 0.2  # Least difference of the success


@dataclass(frozen=True, kw_only=True)
class ForRealCmd:
    """Compare policies trained with and without ``train --for-real`` on a hidden vehicle."""

    out: Path  # Folder for logs, run folders and figures; an interrupted run continues
    seeds: int = 5  # Trainings of each arm
    first_seed: int = 1  # Seed of the first training; each has the next one
    flights: int = 48  # Flights of each policy
    workers: int = 1  # Processes that fly
    phase: Literal["all", "log", "train", "fly", "parts"] = "all"
    max_env_steps: int = 200_000_000  # Of each training
    max_time_s: float = 60.0  # The same, whichever comes first [s]
    num_envs: int | None = None  # Environments of a training; those of the settings if not given
    device: str = "auto"  # Of the training
    stop_after_s: float = 240.0  # No training begins after this time [s]; run again to continue

    def run(self) -> int:
        """Run the phases; return 0, or 1 if something is missing or the limit is missed."""
        self.out.mkdir(parents=True, exist_ok=True)
        if self.phase == "log" or (self.phase == "all" and not RESULT.exists()):
            self._fly_log()
        if self.phase in ("all", "train") and not self._train():
            print(f"{self._num_missing()} trainings are missing: run the same command again", file=sys.stderr)
            return 1
        if self.phase == "parts":
            return self._fly_parts()
        return self._fly() if self.phase in ("all", "fly") else 0

    def _fly_log(self) -> None:
        log = self.out / "log.csv"
        fly_log(log, seed=LOG_SEED)
        PreflightCmd(robot=ROBOT, log=log, rate_hz=100.0).result().write(RESULT)

    def _runs(self) -> list[tuple[str, int, Path]]:
        return [
            (arm, seed, self.out / f"{arm}_{seed}")
            for seed in range(self.first_seed, self.first_seed + self.seeds)
            for arm in ARMS
        ]

    def _num_missing(self) -> int:
        return sum(not (run / "trained.json").exists() for _, _, run in self._runs())

    def _train(self) -> bool:
        """Train what is missing; return whether all is there."""
        started = time.monotonic()
        plan = plan_training(policy_task(), read_result(RESULT))
        for arm, seed, run in self._runs():
            if (run / "trained.json").exists():
                continue
            if time.monotonic() - started > self.stop_after_s:
                return False
            if run.exists():
                shutil.rmtree(run)
            result = TrainCmd(
                task=TASK, robot=ROBOT, trainer="ppo", device=self.device, seed=seed, out=run, num_envs=self.num_envs,
                max_env_steps=self.max_env_steps, max_time_s=self.max_time_s, set=plan.settings if arm == "with" else (),
            ).result()  # fmt: skip
            if result.interrupted:
                return False
            write_weights(run, run)
            shutil.rmtree(run / "checkpoints")
            write_atomic(run / "trained.json", json.dumps(asdict(result)))
            print(f"{run.name}: {result}", file=sys.stderr, flush=True)
        return True

    def _fly(self) -> int:
        with ProcessPoolExecutor(self.workers) as pool:
            rows = list(pool.map(fly_policy, [run for _, _, run in self._runs()], [self.flights] * 2 * self.seeds))
        runs = list(zip(rows, self._runs(), strict=True))
        success = {arm: [row["success_rate"] for row, (own, *_) in runs if own == arm] for arm in ARMS}
        low, high = difference_interval(success["with"], success["without"])
        gain = mean(success["with"]) - mean(success["without"])
        figures = {
            "success": success,
            "difference": gain,
            "low": low,
            "high": high,
            "flights": self.flights,
            "rows": rows,
        }
        write_atomic(self.out / "result.json", json.dumps(figures, indent=1))
        lines = [(run.name, *_figures(row), *_figures(row["own"])) for row, (_, _, run) in runs]
        names = ("success", "crashed", "error")
        heads = (
            "training",
            *(f"{name}, hidden vehicle" for name in names),
            *(f"{name}, its training" for name in names),
        )
        print(table(heads, lines))
        print(f"\ndifference: {100.0 * gain:.0f} points, 95 % interval {100.0 * low:.0f} to {100.0 * high:.0f}")
        return int(gain < LIMIT or low <= 0.0)

    def _fly_parts(self) -> int:
        for arm, _, run in self._runs()[: len(ARMS)]:
            for parts in ((), *((part,) for part in PARTS)):
                row = fly_parts(run, self.flights, parts)
                print(json.dumps({"training": arm, "parts": parts} | {name: row[name] for name in FIGURES}), flush=True)
        return 0


FIGURES = ("success_rate", "crash_rate", "final_error_mean_m")


def fly_parts(run: Path, flights: int, parts: Collection[str]) -> dict:
    """Return the figures of a policy on a vehicle with some parts of the hidden one."""
    policy, _ = load_policy(run, device="cpu")
    with one_thread(), make_hidden_task(flights, seed=FLIGHT_SEED, parts=parts) as task:
        return asdict(evaluate(policy, task))


def policy_task(settings: tuple[str, ...] = (), seed: int = 0) -> PolicyTask:
    """Return the task of the trainings."""
    return PolicyTask(
        name=TASK,
        robot=ROBOT,
        controller=None,
        encoder=None,
        backend=None,
        level=None,
        settings=settings,
        device="cpu",
        seed=seed,
    )


def fly_policy(run: Path, flights: int) -> dict:
    """Return the figures of a policy on the hidden vehicle, and in its own training; from its folder if they are there."""
    kept = run / f"flown_{flights}.json"
    if kept.exists():
        return json.loads(kept.read_text())
    row, (policy, cfg) = fly_parts(run, flights, PARTS), load_policy(run, device="cpu")
    with one_thread(), policy_task(cfg.settings, seed=FLIGHT_SEED).make(flights) as task:
        row["own"] = asdict(evaluate(policy, task))
    write_atomic(kept, json.dumps(row))
    return row


def _figures(row: dict) -> tuple[str, ...]:
    success, crashed, error = (row[name] for name in FIGURES)
    return f"{100.0 * success:.0f} %", f"{100.0 * crashed:.0f} %", "-" if error is None else f"{error:.3f} m"


def difference_interval(first: list[float], second: list[float]) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two mean shares, by Wilson's intervals of both (Newcombe, 1998, method 10).

    One training counts as one trial. A yes or no has the largest scatter of all shares with its mean, so the interval is not
    too narrow, also where all trainings of an arm are equal.
    """
    ends = [wilson_interval(mean(shares), len(shares)) for shares in (first, second)]
    (low_a, high_a), (low_b, high_b) = ends
    a, b = mean(first), mean(second)
    return a - b - hypot(a - low_a, high_b - b), a - b + hypot(high_a - a, b - low_b)


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share of ``count`` trials."""
    square = NormalDist().inv_cdf(0.975) ** 2 / count
    middle, half = share + 0.5 * square, sqrt(square * share * (1.0 - share) + 0.25 * square**2)
    return (middle - half) / (1.0 + square), (middle + half) / (1.0 + square)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(ForRealCmd, description=__doc__).run())
