"""Imported robots hold their place in flight."""

from pathlib import Path

import pytest

from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.importers import RotorHints, import_robot
from benchmarks.control.control_flights import fly_robot
from tests.repetitions import rare_values
from tests.unit.robots.importers.files import CF2, X2, iris, x500


@pytest.mark.parametrize("name", rare_values(["x500", "iris", "x2", "cf2"], ["x500", "iris", "x2"]))
def test_an_imported_robot_holds_its_place(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.xml"
    if name in ("x2", "cf2"):
        path.write_text({"x2": X2, "cf2": CF2}[name], encoding="utf-8")
    else:
        path = {"x500": x500, "iris": iris}[name](tmp_path)
    hints = {"x2": RotorHints(lag=0.03, spins=(1, -1, 1, -1)), "cf2": RotorHints(rotors_of=ROBOTS.get("crazyflie_21"))}
    robot, controller = import_robot(path, hints.get(name)).robot, "lee_position_control"
    flight = fly_robot(robot, CONTROLLERS.get(controller), SIMS.get("base_sim"), names=(name, controller, "base_sim"))
    assert flight.error < 0.02
    assert flight.settling_s < 7.0
    assert flight.overshoot < 0.02
