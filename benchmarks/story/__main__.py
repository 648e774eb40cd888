"""Train, fly, identify the undeclared effects, train again: ``python -m benchmarks.story --out DIR --device cuda``.

For each seed: a policy of the task of motor commands is trained on the vehicle as declared, flown through setpoints on that
vehicle and on the true one, logs six flights of the true one, of which ``close-loop`` fits on four and judges on two; and is
trained again on the robot file that comes out, as it is and with the intervals as what every episode draws (``--ranges``).
All flights are those of the independent plant, of setpoints that nothing was fitted on. What is there already is not made anew.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import torch
import tyro
import yaml

from aerial_gym.config import family_files
from aerial_gym.errors import AerialGymError
from aerial_gym.rl_training import load_policy, load_settings, settings_for, train
from benchmarks.story import setpoint_flight
from benchmarks.undeclared.logs import write_log
from benchmarks.undeclared.sensors import NO_BIAS
from benchmarks.undeclared.simulate import PlantRecord
from benchmarks.undeclared.vehicle import Array

TASK = "position_setpoint_task_sim2real_end_to_end"
ROBOT = family_files("robots")["tinyprop"]
FITTED, JUDGED, SCORED = 4, 2, 1000
"""Flights that are logged to fit on and to judge on, and flights that a policy is scored on."""

CASES = ("as declared", "true vehicle", "trained again on what was found", "the same with intervals")


@dataclass(frozen=True, kw_only=True)
class Story:
    """One policy for each seed, from its training to its second and third."""

    out: Path  # Folder of everything; what stands there already is kept

    seeds: tuple[int, ...] = (16, 26, 36, 46, 56)
    """Of trainings; the vehicle and the scored setpoints are the same for all."""

    steps: int = 160_000_000  # Environment steps of each training: those of the paper
    device: str = "auto"  # Torch device of the trainings; flights are on the CPU
    settings: Path | None = None  # Settings of the trainings; those that come with the task if not given
    jobs: int = 2  # Processes that fly and score policies beside the trainings
    vehicle_seed: int = 7  # Of the small errors of the declaration, and of the sensors'

    def run(self) -> int:
        """Do all of it, print one line for each flight of a policy, and draw the figure."""
        with ProcessPoolExecutor(self.jobs, get_context("spawn"), torch.set_num_threads, (1,)) as pool:
            first, loops, scores = {}, {}, {}
            for seed in self.seeds:
                first[seed] = self._train_policy(seed, "declared", ROBOT)
                loops[seed] = self._start_close_loop(seed, first[seed])
                for case in CASES[:2]:
                    scores[seed, case] = pool.submit(self._score_policy, first[seed], as_declared=case == CASES[0])
            for seed in self.seeds:
                results = self._close_loop_robots(seed, loops[seed])
                for case, robot in zip(CASES[2:], ("robot", "ranges"), strict=True):
                    folder = self._train_policy(seed, "found" if robot == "robot" else robot, results[robot])
                    scores[seed, case] = pool.submit(self._score_policy, folder, as_declared=False)
            rows = []
            for seed in self.seeds:
                for case in CASES:
                    rows.append({"seed": seed, "case": case, **scores[seed, case].result()})
                    print(json.dumps({key: value for key, value in rows[-1].items() if key != "trace"}), flush=True)
        (self.out / "rows.json").write_text(json.dumps(rows))
        draw_story(rows, self.out / "story.png")
        return 0

    def _train_policy(self, seed: int, name: str, robot: Path) -> Path:
        """Return the folder of a policy that was trained on a robot."""
        folder = self.out / f"seed_{seed}" / name
        done = folder / "done"
        if not done.exists():
            cfg = load_settings(self.settings or settings_for("ppo", TASK, device=self.device))
            cfg = replace(
                cfg,
                task=TASK,
                robot=str(robot),
                seed=seed,
                device=self.device,
                max_time_s=None,
                max_env_steps=self.steps,
            )
            shutil.rmtree(folder, ignore_errors=True)  # of a training that was cut off
            train(cfg, folder)
            done.touch()
        return folder

    def _score_policy(self, folder: Path, *, as_declared: bool) -> dict[str, object]:
        """Return the tracking errors of a policy at new setpoints; ``trace`` is the distance over time of the median flight."""
        kept = folder / ("score_as_declared.json" if as_declared else "score.json")
        if kept.exists():
            return json.loads(kept.read_text())
        points = setpoint_flight.draw_setpoints(SCORED, seed=1_000_003)
        record = self._fly_policy(folder, points, seed=1_000_003, as_declared=as_declared)
        away = setpoint_flight.setpoint_distances(record, points)
        typical = away[:, away.mean(axis=0).argsort()[SCORED // 2]]
        score = {
            **asdict(setpoint_flight.tracking_errors(record, points)),
            "trace": [float(value) for value in typical[:: setpoint_flight.CONTROL_RATE // 50]],
        }
        kept.write_text(json.dumps(score))
        return score

    def _fly_policy(self, folder: Path, points: Array, *, seed: int, as_declared: bool = False) -> PlantRecord:
        """Return the flights of a policy through points (P, F, 3)."""
        policy, _ = load_policy(folder, device="cpu")
        declared = setpoint_flight.nominal_vehicle(ROBOT)
        true, bias = (
            (declared, NO_BIAS) if as_declared else setpoint_flight.true_vehicle(declared, seed=self.vehicle_seed)
        )
        return setpoint_flight.fly_setpoints(policy, declared=declared, true=true, bias=bias, points=points, seed=seed)

    def _start_close_loop(self, seed: int, policy: Path) -> subprocess.Popen[bytes] | None:
        """Log flights of a policy and start the loop on them."""
        folder = self.out / f"seed_{seed}" / "flights"
        result = folder.with_name("close_loop")
        if (result / "verdict.json").exists():
            return None
        folder.mkdir(parents=True, exist_ok=True)
        points = setpoint_flight.draw_setpoints(FITTED + JUDGED, seed=seed)
        record = self._fly_policy(policy, points, seed=seed)
        logs = [folder / f"flight_{i + 1}.csv" for i in range(FITTED + JUDGED)]
        for i, path in enumerate(logs):
            write_log(path, record, i, slice(None))
        (folder / "truth.json").write_text(json.dumps(setpoint_flight.HIDDEN))
        command = [sys.executable, "-c", "from aerial_gym.cli.main import entry; entry()", "close-loop", "--ranges"]
        parts = ("--robot", ROBOT, "--train", *logs[:FITTED], "--test", *logs[FITTED:], "--out", result)
        told = (folder / "close_loop.log").open("wb")
        return subprocess.Popen([*command, *(str(part) for part in parts)], stdout=told, stderr=told)

    def _close_loop_robots(self, seed: int, loop: "subprocess.Popen[bytes] | None") -> dict[str, Path]:
        """Return the robot file that the loop wrote, and the same without domain randomisation."""
        result = self.out / f"seed_{seed}" / "close_loop"
        if loop is not None and loop.wait():
            raise RuntimeError((result.parent / "flights" / "close_loop.log").read_text())
        verdict = json.loads((result / "verdict.json").read_text())
        results = [{key: effect[key] for key in ("name", "params", "interval")} for effect in verdict["effects"]]
        print(json.dumps({"seed": seed, "verdict": verdict["verdict"], "effects": results}), flush=True)
        document = yaml.safe_load((result / "robot.yaml").read_text())
        document.pop("randomize", None)
        plain = result.with_name("robot.yaml")
        plain.write_text(yaml.safe_dump(document, sort_keys=False))
        return {"robot": plain, "ranges": result / "robot.yaml"}


def draw_story(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the figure of rows with ``seed``, ``case``, ``error_m``, ``lost``, and ``trace``: distances [m] at 50 Hz."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.0), width_ratios=(1.0, 1.3), layout="constrained")
    traces: dict[str, list[float]] = {}
    for row in rows:
        traces.setdefault(row["case"], row["trace"])
    colours = ("tab:gray", "tab:red", "tab:blue", "tab:green")
    for place, (case, colour) in enumerate(zip(traces, colours, strict=True)):
        own = [row for row in rows if row["case"] == case]
        errors = [row["error_m"] for row in own]
        left.bar(place, median(errors), color=colour, alpha=0.4, width=0.7)
        left.plot([place] * len(errors), errors, "o", color=colour, markersize=4)
        lost = max(row["lost"] for row in own)
        left.annotate(
            f"{median(errors):.3f} m" + (f"\nlost ≤ {lost:.1%}" if lost else ""),
            (place, max(errors)),
            xytext=(0, 5),
            textcoords="offset points",
            ha="center",
        )
        trace = traces[case]
        right.plot([i / 50.0 for i in range(len(trace))], trace, color=colour, label=case)
    left.set_xticks(
        range(len(traces)), [case.replace(" on ", "\non ").replace(" with ", "\nwith ") for case in traces], fontsize=8
    )
    left.set_ylabel("error at setpoints [m]: every seed, median")
    left.margins(y=0.15)
    right.set_yscale("log")
    right.set_ylim(0.005, 1.5)
    right.set_xlabel("time [s]")
    right.set_ylabel("distance to the setpoint [m]")
    right.legend(fontsize=8, loc="lower center", ncols=2)
    figure.savefig(path, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(Story).run())
    except AerialGymError as error:
        print(f"story: {error}", file=sys.stderr)
        sys.exit(2)
