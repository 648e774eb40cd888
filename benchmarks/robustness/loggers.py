"""Does the loop still name what is hidden when logs are written as loggers write them?

    python -m benchmarks.robustness.loggers --seed 4101 [--changes imu_filtered rotor_late] [--jobs 2] [--json]

Each case of the undeclared plant (nuisance errors, moderate effects, one at a time, and none) is judged again with its logs
changed: sensors late or filtered, scaled, elsewhere, repeated, missing, drifting, with gaps. A row for each change: how many
verdicts are right, and what was said of the others. What a change takes away cannot be found: without commands no lag.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import signal
from scipy.spatial.transform import Rotation

from benchmarks.scores.score_undeclared import BANDWIDTH_HZ, THREADS, judge
from benchmarks.undeclared import EFFECTS, make_case

Array = NDArray[np.float64]
Change = Callable[[pd.DataFrame, np.random.Generator], pd.DataFrame]

POSITION, ATTITUDE, VELOCITY = [f"p_{a}" for a in "xyz"], [f"q_{a}" for a in "xyzw"], [f"v_{a}" for a in "xyz"]
GYRO, ACC, ROTORS, COMMANDS = (
    [f"omega_{a}" for a in "xyz"],
    [f"acc_{a}" for a in "xyz"],
    [f"rotor_{n}" for n in range(1, 5)],
    [f"cmd_{n}" for n in range(1, 5)],
)
HIDDEN = (
    *("nothing", "rotor_drag", "com_offset", "thrust_coefficient", "payload_mass", "weak_motor", "constant_wind"),
    "motor_time_constant",
)


def late(columns: list[str], seconds: float) -> Change:
    """Return what moves columns to the later."""
    return lambda log, _rng: log.assign(**{c: np.interp(log["t"] - seconds, log["t"], log[c]) for c in columns})


def filtered(order: int, **corners: float) -> Change:
    """Return what low-passes the columns of some sensors, each with its corner [Hz], as it runs."""
    columns = {"acc": ACC, "gyro": GYRO, "velocity": VELOCITY}

    def change(log: pd.DataFrame, _rng: np.random.Generator) -> pd.DataFrame:
        for name, corner in corners.items():
            sections = signal.butter(order, corner, fs=rate_of(log), output="sos")
            for column in columns[name]:
                values = log[column].to_numpy()
                log[column] = signal.sosfilt(sections, values, zi=signal.sosfilt_zi(sections) * values[0])[0]
        return log

    return change


def scaled(columns: list[str], std: float) -> Change:
    """Return what scales each of some columns by itself; the same in all logs of a case."""
    return lambda log, rng: log.assign(
        **{c: log[c] * (1.0 + one) for c, one in zip(columns, draw(rng, std), strict=True)}
    )


def drifting(columns: list[str], std: float) -> Change:
    """Return what adds a bias that grows from nothing to its end of a flight."""
    return lambda log, rng: log.assign(
        **{c: log[c] + one * log["t"] / log["t"].max() for c, one in zip(columns, draw(rng, std), strict=True)}
    )


def elsewhere(log: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Return the log of an accelerometer 1 cm (standard deviation of each axis) from the origin."""
    place, rate = draw(rng, 0.01), log[GYRO].to_numpy()
    sections = signal.butter(2, 60.0, fs=rate_of(log), output="sos")
    rate = signal.sosfiltfilt(sections, rate, axis=0)
    turning = np.gradient(rate, log["t"], axis=0)
    log[ACC] += np.cross(turning, place) + np.cross(rate, np.cross(rate, place))
    return log


def repeated(log: pd.DataFrame, _rng: np.random.Generator) -> pd.DataFrame:
    """Return the log of a motion capture with a quarter of its rate, whose last row is repeated."""
    rows = np.arange(len(log)) // 4 * 4
    log[POSITION + ATTITUDE + VELOCITY] = log[POSITION + ATTITUDE + VELOCITY].to_numpy()[rows]
    return log


def tilted(log: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Return the log of a motion capture whose floor is not level, by 0.005 rad about each axis."""
    turn = Rotation.from_rotvec(draw(rng, 0.005))
    for columns in (POSITION, VELOCITY):
        log[columns] = turn.apply(log[columns].to_numpy(copy=True))
    log[ATTITUDE] = (turn * Rotation.from_quat(log[ATTITUDE].to_numpy(copy=True))).as_quat()
    return log


def derived(log: pd.DataFrame, _rng: np.random.Generator) -> pd.DataFrame:
    """Return the log with velocities that are derivatives of positions, below 12 Hz."""
    sections = signal.butter(2, 12.0, fs=rate_of(log), output="sos")
    log[VELOCITY] = np.gradient(signal.sosfiltfilt(sections, log[POSITION].to_numpy(), axis=0), log["t"], axis=0)
    return log


def thinned(every: int) -> Change:
    """Return what keeps each so many-th row."""
    return lambda log, _rng: log.iloc[::every].reset_index(drop=True)


def without(columns: list[str]) -> Change:
    """Return what leaves columns out."""
    return lambda log, _rng: log.drop(columns=columns)


def with_gaps(log: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Return the log without every twentieth row, at random."""
    return log.iloc[np.flatnonzero(rng.random(len(log)) > 0.05)].reset_index(drop=True)


CHANGES: dict[str, Change] = {
    "none": lambda log, _rng: log,
    "tracking_late": late(POSITION + ATTITUDE + VELOCITY, 0.008),
    "rotor_late": late(ROTORS, 0.010),
    "imu_filtered": filtered(2, acc=30.0, gyro=80.0),
    "velocity_filtered": filtered(1, velocity=8.0),
    "acc_scaled": scaled(ACC, 0.01),
    "gyro_scaled": scaled(GYRO, 0.01),
    "acc_elsewhere": elsewhere,
    "acc_drifting": drifting(ACC, 0.05),
    "gyro_drifting": drifting(GYRO, 0.005),
    "velocity_derived": derived,
    "tracking_repeated": repeated,
    "floor_tilted": tilted,
    "rotor_coarse": lambda log, _rng: log.assign(**{c: (log[c] / 20.0).round() * 20.0 for c in ROTORS}),
    "slow_100": thinned(4),
    "slow_50": thinned(8),
    "gaps": with_gaps,
    "no_rotors": without(ROTORS),
    "no_commands": without(COMMANDS),
    "no_velocity": without(VELOCITY),
    "no_accelerometer": without(ACC),
}


def draw(rng: np.random.Generator, std: float) -> Array:
    """Return a number for each of three axes, cut at two standard deviations."""
    return std * np.clip(rng.standard_normal(3), -2.0, 2.0)


def rate_of(log: pd.DataFrame) -> float:
    """Return the rate of a log [Hz]."""
    return 1.0 / float(np.median(np.diff(log["t"])))


def score(change: str, hidden: str, seed: int) -> dict[str, Any]:
    """Return what the loop makes of one case with its logs changed; what it raised stands under ``error``."""
    from aerial_gym.interop import one_thread
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.sim2real.in_memory import judge_flights
    from aerial_gym.sim2real.logs.inputs import load_train_and_test

    effects, row = {} if hidden == "nothing" else {hidden: "moderate"}, {"change": change, "hidden": hidden}
    with tempfile.TemporaryDirectory() as folder, one_thread():
        try:
            files = make_case(Path(folder) / "case", effects=effects, seed=seed, nuisance=True)
            for path in (*files.train, *files.test):  # the same error in all logs of a case
                changed = CHANGES[change](pd.read_csv(path), np.random.default_rng([seed, 77]))
                changed.to_csv(path, index=False, float_format="%.8g")
            robot = robot_by_name(files.robot)
            flights = load_train_and_test(robot, files.train, files.test, None, BANDWIDTH_HZ)
            verdict = judge_flights(robot, *flights, bandwidth=BANDWIDTH_HZ).verdict.as_mapping()
        except Exception as error:  # one bad case must not end the others; it is counted
            return {**row, "right": False, "verdict": f"{type(error).__name__}: {error}", "named": []}
        return {**row, **judge(verdict, json.loads(files.truth.read_text())["effects"])}


def main() -> int:
    """Score the cases and print a row for each change; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--changes", nargs="+", choices=CHANGES, default=list(CHANGES), metavar="CHANGE")
    parser.add_argument("--hidden", nargs="+", choices=["nothing", *EFFECTS], default=list(HIDDEN), metavar="EFFECT")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object a case")
    args = parser.parse_args()
    os.environ.update(dict.fromkeys(THREADS, "1"))  # before the processes start: one core each
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        jobs = {name: [pool.submit(score, name, one, args.seed) for one in args.hidden] for name in args.changes}
        for name, futures in jobs.items():
            rows = [future.result() for future in futures]
            if args.json:
                print("\n".join(json.dumps(row) for row in rows), flush=True)
                continue
            others = [f"{r['hidden']}: {r['verdict']} {', '.join(r['named']) or '-'}" for r in rows if not r["right"]]
            print(f"{name}: {len(rows) - len(others)} of {len(rows)} right; {'; '.join(others) or 'all'}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
