"""A racing policy by the protocol of its benchmark: ``python -m benchmarks.learning.racing --policy RUN --levels level0.toml``.

lsy_drone_racing flies 20 runs of a level and tells how many were complete, the gates passed and the mean time of complete runs.
Twenty runs say little of a success rate (19 of 20: 75 to 100 %), so that as many more as wanted stand beside them.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

RUNS = 20  # Of a level. Source: README of github learnsyslab/lsy_drone_racing.


@dataclass(frozen=True, kw_only=True)
class BenchRacing:
    """Runs of a racing policy on levels, 20 as the benchmark does and more beside them."""

    policy: Path  # Run folder of a training, a checkpoint in it, or an exported file (.onnx, .pt, .c)

    levels: tuple[str, ...] = ("racing_task", "racing_random_track_task")
    """Level files of the benchmark (.toml), or registered tasks."""

    num_envs: int = 1000  # Runs beside the 20 of the protocol
    seed: int = 1_000_003  # Of the runs
    device: str = "cpu"  # Torch device; auto takes the GPU if there is one
    json: bool = False  # One object a line, keys end in their unit

    def run(self) -> int:
        """Fly and print a row for each level and number of runs; return the exit status."""
        if not self.json:
            print("| level | runs | complete | 95 % interval | gates passed | crashed | time of a complete run |")
            print("| --- | --- | --- | --- | --- | --- | --- |")
        for row in self._rows():
            print(json.dumps(row) if self.json else _line(row), flush=True)
        return 0

    def _rows(self) -> Iterator[dict[str, float | str | None]]:
        """Fly each level twice from the same seed: the 20 runs are the first ones of the others."""
        from scipy.stats import binomtest

        from aerial_gym.export.pilot import load_pilot
        from aerial_gym.rl_training.evaluation import evaluate
        from aerial_gym.rl_training.policies.load import check_fits
        from aerial_gym.task import task_registry

        policy, trained = load_pilot(self.policy, self.device)
        for level in self.levels:
            for runs in (RUNS, self.num_envs):
                with task_registry.make_task(level, num_envs=runs, device=self.device, seed=self.seed) as task:
                    check_fits(policy, task, trained.task)
                    result = evaluate(policy, task)
                complete = round(result.success_rate * runs)
                interval = binomtest(complete, runs).proportion_ci()  # Clopper and Pearson, 95 %
                yield {
                    "level": Path(level).stem, "runs": runs, "complete": complete,
                    "complete_low": float(interval.low), "complete_high": float(interval.high),
                    "gates_passed_mean": result.gates_passed_mean, "crash_rate": result.crash_rate,
                    "lap_time_mean_s": result.success_time_mean_s,
                }  # fmt: skip


def _line(row: dict[str, float | str | None]) -> str:
    time = "-" if row["lap_time_mean_s"] is None else f"{row['lap_time_mean_s']:.2f} s"
    return (
        f"| {row['level']} | {row['runs']} | {row['complete']} | {row['complete_low']:.1%} to {row['complete_high']:.1%} "
        f"| {row['gates_passed_mean']:.2f} | {row['crash_rate']:.1%} | {time} |"
    )


if __name__ == "__main__":
    import sys

    import tyro

    from aerial_gym.errors import AerialGymError

    try:
        sys.exit(tyro.cli(BenchRacing).run())
    except AerialGymError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
