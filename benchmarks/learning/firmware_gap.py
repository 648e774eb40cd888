"""Fly policies on Betaflight itself and on ``betaflight_rate_control``, and let ``close-loop`` look for the difference.

    python -m benchmarks.learning.firmware_gap --policies run1 run2 --out gap

Each policy flies from the same starts on both. The first one also writes flight logs on the firmware, twice: with the
firmware's own rotor commands, and with those that the controller here gives for the same sensors and actions. ``close-loop``
gets the declared vehicle as model, so that the second run compares the firmware with the controller.
Letters: E environments, R rotors, T rows.
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from torch import Tensor

from aerial_gym.cli.evaluate import PolicyOptions
from aerial_gym.firmware.betaflight.environment import PERIOD_S, BetaflightEnv
from aerial_gym.firmware.comparison import TwinObserver
from aerial_gym.interop import one_thread
from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.sim2real import close_loop
from benchmarks.markdown import table

ROW_STEPS = 2  # Physics steps of a millisecond for each row of a log
SIDES = {"commands of the firmware": "firmware", "commands of the controller here": "controller"}


@dataclass(frozen=True, kw_only=True)
class FirmwareGap:
    """Measure the gap between Betaflight and the controller that follows it."""

    policies: tuple[Path, ...]  # Run folders of trainings on betaflight_rate_control
    out: Path  # Folder for logs and results of close-loop
    robot: str = "racing_quadrotor"  # Declared vehicle of the trainings, as the model of close-loop
    num_envs: int = 32  # Random starts of each policy
    flights: int = 4  # Logged flights, of which the last quarter is for the test
    duration_s: float = 10.0  # Length of each [s]


class TwinRecorder(TwinObserver):
    """Keeps the columns of ``close-loop``'s CSV files at every exchange with the firmware, but for the time."""

    def __init__(self, env: BetaflightEnv) -> None:
        super().__init__(env)
        self._env, self.rows = env, list[Tensor]()

    def __call__(self, action: Tensor, speeds: Tensor) -> None:
        super().__call__(action, speeds)
        gtd, imu = self._env.gtd, self._env.imu_reading
        states = (gtd["robot_position"], gtd["robot_orientation"], gtd["robot_linvel"])
        self.rows.append(
            torch.cat((*states, imu[:, 3:], imu[:, :3], gtd["rotor_speed"], speeds, self.commands[-1][0]), dim=-1)
        )


def write_logs(rows: Tensor, folder: Path) -> dict[str, list[Path]]:
    """Write rows (T, E, N) as one CSV file for each environment and side; return the files by side."""
    folder.mkdir(parents=True, exist_ok=True)
    names = ["t", *(f"p_{a}" for a in "xyz"), *(f"q_{a}" for a in "xyzw"), *(f"v_{a}" for a in "xyz")]
    names += [*(f"omega_{a}" for a in "xyz"), *(f"acc_{a}" for a in "xyz"), *(f"rotor_{k}" for k in range(1, 5))]
    names += [f"cmd_{k}" for k in range(1, 5)]
    files: dict[str, list[Path]] = {}
    for number, side in enumerate(SIDES.values()):
        for env in range(rows.shape[1]):
            flight = rows[::ROW_STEPS, env]
            command = flight[:, 20 + 4 * number : 24 + 4 * number]
            file = folder / f"{side}_{env}.csv"
            with file.open("w", encoding="utf-8", newline="") as out:
                writer = csv.writer(out)
                writer.writerow(names)
                for step, row in enumerate(torch.cat((flight[:, :20], command), dim=-1).tolist()):
                    writer.writerow([round(step * ROW_STEPS * PERIOD_S, 6), *(f"{value:.7g}" for value in row)])
            files.setdefault(side, []).append(file)
    return files


def fly_logged(options: PolicyOptions, *, flights: int, duration: float) -> Tensor:
    """Return rows (T, E, N) of flights of a policy on the firmware."""
    policy, _, flown = options.load()
    with replace(flown, firmware="betaflight").make(flights) as task, one_thread(), torch.no_grad():
        observation, _ = task.reset()
        policy.reset()
        assert isinstance(task.env, BetaflightEnv)
        recorder = TwinRecorder(task.env)
        for _ in range(round(duration / task.env.dt)):
            observation, *_ = task.step(policy(observation))
        return torch.stack(recorder.rows)


def evaluate_sides(options: PolicyOptions, num_envs: int) -> tuple[dict[str, float | None], ...]:
    """Return final error [m] and crash rate on the controller here, at the firmware's rate, and on the firmware."""
    policy, _, flown = options.load()
    results = []
    for firmware in (None, "betaflight"):
        with replace(flown, firmware=firmware).make(num_envs) as task, one_thread():
            policy.reset()
            result = evaluate(policy, task)
        results.append({"error_m": result.final_error_mean_m, "crash_rate": result.crash_rate})
    return tuple(results)


def main(args: FirmwareGap) -> None:
    """Print a table of the policies and one of the verdicts."""
    rows, gaps = list[Sequence[str]](), list[float]()
    at_firmware_rate = (f"sim.dt={PERIOD_S}", "env.physics_steps_per_env_step=10")
    for policy in args.policies:
        options = PolicyOptions(policy=policy, set=at_firmware_rate)
        here, firmware = evaluate_sides(options, args.num_envs)
        gaps.append(1000.0 * (firmware["error_m"] - here["error_m"]))  # type: ignore[operator]
        rows.append((policy.name, f"{here['error_m']:.4f}", f"{firmware['error_m']:.4f}", f"{gaps[-1]:+.1f}",
                     f"{here['crash_rate']:.0%}", f"{firmware['crash_rate']:.0%}"))  # fmt: skip
        print(rows[-1], flush=True)
    print(table(("policy", "error here [m]", "on Betaflight [m]", "gap [mm]", "crashes here", "there"), rows))
    print(f"gap {np.mean(gaps):+.2f} mm on average, {min(gaps):+.2f} to {max(gaps):+.2f} mm, of {len(gaps)} policies")
    options = PolicyOptions(policy=args.policies[0], set=at_firmware_rate)
    logs = fly_logged(options, flights=args.flights, duration=args.duration_s)
    files = write_logs(logs, args.out / "logs")
    command = (logs[..., 20:24] - logs[..., 24:28]).double()
    print(f"rotor commands, firmware minus controller: rms {float(command.square().mean().sqrt()):.2f} rad/s")
    cut = max(1, args.flights - args.flights // 4)
    verdicts: list[Sequence[str]] = []
    for text, side in SIDES.items():
        flights = files[side]
        close_loop(args.robot, flights[:cut], flights[cut:], args.out / side)
        stored = json.loads((args.out / side / "verdict.json").read_text(encoding="utf-8"))
        verdicts.append((text, stored["verdict"], stored["reason"]))
    print(table(("logged", "verdict", "reason"), verdicts))


if __name__ == "__main__":
    main(tyro.cli(FirmwareGap))
