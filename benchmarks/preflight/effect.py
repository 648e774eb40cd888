"""Effect of a preflight check: a policy trained on a wrong file, and one trained on the corrected file, fly the true vehicle.

    python -m benchmarks.preflight.effect --out DIR [--task position_setpoint_task] [--max-env-steps 5000000] [--device cpu]

A vehicle of the undeclared plant has one fault: 10 % less thrust, or 50 ms of latency of its commands. Its log is compared with
its robot file, and the numbers of the contradictions are put into the file, or into the task. Policies are trained on the
original and on the corrected file. Both fly the file with the true fault, from the same starts. An interrupted run continues.
"""

import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import tyro
import yaml

from aerial_gym.rl_training import evaluate, load_policy, load_settings, settings_for, train
from aerial_gym.sim2real.preflight.check import Preflight, preflight
from aerial_gym.task import task_registry
from benchmarks.markdown import table
from benchmarks.preflight.__main__ import TRAINING
from benchmarks.preflight.faults import POLICY_HZ, draw_fault
from benchmarks.preflight.flights import fly_vehicle

FAULTS = {"thrust": {"scale": 0.9}, "command_latency": {"delay": 0.05}}
"""Faults of the issue: 10 % less thrust, 50 ms of latency."""

DELAY_STEPS = "the action delay_steps of the task"


@dataclass(frozen=True, kw_only=True)
class TaskVehicle:
    """A robot file, and settings of the task for what a robot file does not hold."""

    robot: Path
    settings: tuple[str, ...] = ()

    def with_effect(self, path: Path, name: str, parameters: Mapping[str, float]) -> "TaskVehicle":
        """Return the vehicle with an effect in its file, written to ``path``."""
        document = yaml.safe_load(self.robot.read_text(encoding="utf-8"))
        document["effects"] = document.get("effects", {}) | {name: dict(parameters)}
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return replace(self, robot=path)

    def with_latency(self, seconds: float) -> "TaskVehicle":
        """Return the vehicle with commands so late, in whole steps of the policy."""
        return replace(self, settings=(*self.settings, f"task.action.delay_steps={round(seconds * POLICY_HZ)}"))


def correct_vehicle(vehicle: TaskVehicle, result: Preflight, path: Path) -> TaskVehicle:
    """Return the vehicle with the numbers of all contradictions."""
    for finding in result.contradictions:
        setting, new = str(finding.values.get("setting")), float(finding.values.get("new") or 0.0)
        if setting == DELAY_STEPS:
            vehicle = vehicle.with_latency(new)
        elif setting.startswith("effects."):
            _, effect, parameter = setting.split(".")
            vehicle = vehicle.with_effect(path, effect, {parameter: new})
        else:
            raise ValueError(f"{finding.code} {finding.subject}: this benchmark cannot put {setting!r} into a file")
    return vehicle


@dataclass(frozen=True, kw_only=True)
class EffectCmd:
    """Fly policies trained before and after the findings of a preflight check."""

    out: Path  # Folder of logs, files, trainings and results
    task: str = "position_setpoint_task"
    faults: tuple[str, ...] = tuple(FAULTS)
    seed: int = 1  # Of trainings; vehicles are the first ones from here on whose draw is the fault
    max_env_steps: int = 5_000_000  # Of each training
    num_envs: int = 512  # Starts of each evaluation
    device: str = "cpu"
    robot_settings: tuple[str, ...] = ()  # Further settings of the vehicle, such as a smaller largest thrust
    json: bool = False  # One JSON object a flight

    def run(self) -> int:
        """Train, fly and print."""
        rows = list[dict[str, object]]()
        for kind in self.faults:
            folder = self.out / kind
            seed = next(k for k in itertools.count(self.seed) if draw_fault(kind, k).values == FAULTS[kind])
            log, declared = folder / "log.csv", TaskVehicle(robot=folder / "robot.yaml", settings=self.robot_settings)
            if not log.exists():
                fly_vehicle(folder, kind, seed)
            result = preflight(declared.robot, log, training=TRAINING)
            result.write(folder / "preflight.json")
            named = ", ".join(finding.subject for finding in result.contradictions)
            after = correct_vehicle(declared, result, folder / "corrected.yaml")
            true = declared
            if kind == "thrust":
                true = declared.with_effect(folder / "true.yaml", "thrust_coefficient", FAULTS[kind])
            else:
                true = declared.with_latency(FAULTS[kind]["delay"])
            trainings = (("original", declared, folder / "original"), ("corrected", after, folder / "corrected"))
            for name, trained, run in trainings:
                self.train(trained, run)
                flights = (("its own", trained), ("true", true)) if name == "original" else (("true", true),)
                for flown, vehicle in flights:
                    rows.append(
                        {"fault": kind, "named": named, "file": name, "vehicle": flown, **self.fly(run, vehicle)}
                    )
                    if self.json:
                        print(json.dumps(rows[-1]), flush=True)
        if not self.json:
            print(text(rows))
        return 0

    def train(self, vehicle: TaskVehicle, run: Path) -> None:
        """Train a policy on a vehicle, or continue."""
        cfg = load_settings(settings_for("ppo", self.task, device=self.device))
        cfg = replace(
            cfg, task=self.task, robot=str(vehicle.robot), settings=vehicle.settings, seed=self.seed, device=self.device,
            max_time_s=None, max_env_steps=self.max_env_steps,
        )  # fmt: skip
        if not (run / "result.json").exists():
            train(cfg, run, resume=run.exists())

    def fly(self, run: Path, vehicle: TaskVehicle) -> dict[str, object]:
        """Return success and crash rates and the error of a policy on a vehicle."""
        policy, cfg = load_policy(run, device=self.device)
        with task_registry.make_task(
            self.task, num_envs=self.num_envs, device=self.device, seed=1_000_003, robot=str(vehicle.robot),
            controller=cfg.controller, settings=vehicle.settings,
        ) as task:  # fmt: skip
            figures = asdict(evaluate(policy, task))
        return {name: figures[name] for name in ("crash_rate", "success_rate", "final_error_mean_m")}


def text(rows: list[dict]) -> str:
    """Return the flights as markdown."""
    heads = ("fault", "contradicted", "trained on the file", "flown vehicle", "crashed", "within 0.1 m", "mean error")
    lines = [
        (row["fault"], row["named"], row["file"], row["vehicle"], f"{100.0 * row['crash_rate']:.1f} %",
         f"{100.0 * row['success_rate']:.1f} %",
         "-" if row["final_error_mean_m"] is None else f"{row['final_error_mean_m']:.3f} m") for row in rows
    ]  # fmt: skip
    return table(heads, lines)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(EffectCmd, description=__doc__).run())
