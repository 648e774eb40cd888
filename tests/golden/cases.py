"""Golden results of the closed loop: flights of the independent truth plant, and what ``close-loop`` makes of them."""

import csv
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from aerial_gym.config import read_yaml
from aerial_gym.sim2real import close_loop
from benchmarks.undeclared import PlantFailure, make_case

HAS_PROSE = True

TOLERANCE_ELSEWHERE = 5e-3
"""Largest relative difference of numbers on another kind of machine; AVX-512 in place of SSE changes them by up to 3.5e-4."""

FLIGHTS: dict[str, Any] = {"seed": 211, "num_train": 3, "num_test": 1, "duration_s": 6.0, "rate_hz": 200}

CASES: dict[str, dict[str, Any]] = {
    "nothing": {"effects": {}},
    "com_offset": {"effects": {"com_offset": "moderate"}},
    "weak_motor": {"effects": {"weak_motor": "large"}, "nuisance": True},
    "gusts": {"effects": {"gusts": "moderate"}},
    "ground_effect": {"effects": {"ground_effect": "large"}},
    "slung_payload": {"effects": {"slung_payload": "moderate"}},
    "two_effects": {"effects": {"com_offset": "moderate", "constant_wind": "moderate"}},
    "payload_in_hover": {"effects": {"payload_mass": "moderate"}, "features": ("hover",)},
    "unknown_time": {"effects": {"unknown_time": "moderate"}},
    "unknown_position": {"effects": {"unknown_position": "large"}},
    "failure_beside_effect": {
        "effects": {"com_offset": "moderate"},
        "failures": {"train_2": PlantFailure(kind="motor_failure", motor=3, scale=0.85, time=3.0)},
    },
    "two_failures": {
        "effects": {},
        "failures": {
            "train_1": PlantFailure(kind="brown_out", scale=0.85, time=3.0, duration=0.8),
            "test_1": PlantFailure(kind="stuck_rotor", motor=2, time=3.5),
        },
    },
}
"""What each case hides from the declared vehicle."""

OPTIONS: dict[str, dict[str, Any]] = {
    "com_offset": {"ranges": True},
    "unknown_position": {"learn_residual": True},
    "failure_beside_effect": {"failures": True},
    "two_failures": {"failures": True},
}
"""Options of ``close_loop``."""

QUICK = ("com_offset",)


def items() -> dict[str, bool]:
    """Return the names of all results, and whether each is a quick one."""
    return {name: name in QUICK for name in CASES}


def measure(item: str) -> dict[str, Any]:
    """Return verdict.json without sentences, robot.yaml, and the figures of residuals.csv of one case."""
    with tempfile.TemporaryDirectory() as folder:
        out = _close_loop(item, Path(folder))
        verdict = json.loads((out / "verdict.json").read_text(encoding="utf-8"))
        return {
            **{f"verdict.{key}": value for key, value in verdict.items()},
            **{f"robot.{key}": value for key, value in read_yaml(out / "robot.yaml").items()},
            "residuals": _columns(out / "residuals.csv"),
            "files": sorted(path.name for path in out.iterdir()),
        }


def robot_yaml_with_origins(item: str) -> str:
    """Return the text of robot.yaml of one case."""
    with tempfile.TemporaryDirectory() as folder:
        return (_close_loop(item, Path(folder)) / "robot.yaml").read_text(encoding="utf-8")


def _close_loop(item: str, folder: Path) -> Path:
    """Fly a case and close the loop; return the folder of the results."""
    files = make_case(folder / "case", **FLIGHTS | CASES[item])
    close_loop(files.robot, files.train, files.test, folder / "out", **OPTIONS.get(item, {}))
    return folder / "out"


def _columns(path: Path) -> dict[str, Any]:
    """Return mean and root mean square of each column of numbers, and the number of rows of each flight."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    flights = [row["flight"] for row in rows]
    figures: dict[str, Any] = {name: flights.count(name) for name in dict.fromkeys(flights)}
    for column in [name for name in rows[0] if name not in ("flight", "set")]:
        values = np.array([float(row[column] or "nan") for row in rows])
        known = values[np.isfinite(values)]
        figures[column] = [float(known.mean()), float(np.sqrt(np.square(known).mean()))] if known.size else []
    return figures
