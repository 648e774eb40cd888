"""Imported robots: composites against an independent engine (MuJoCo), and flights that hold them in place."""

from pathlib import Path

import numpy as np
import pytest

from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.importers import RotorHints, import_robot
from benchmarks.control.control_flights import fly_robot
from tests.cross.test_composites import Part, composite
from tests.repetitions import rare_values
from tests.unit.robots.importers.files import CF2, X2, iris, x500

BLADE = (3.8464910483993325e-07, 2.6115851691700804e-05, 2.649858234714004e-05)
IRIS_BLADE = (9.75e-07, 0.000273104, 0.000274004)
PARTS: dict[str, list[Part]] = {
    "x500": [
        (2.0, (0.0, 0.0, 0.0), (0.02166666666666667, 0.02166666666666667, 0.04000000000000001)),
        *((0.016076923076923075, (x, y, 0.06), BLADE) for x in (-0.174, 0.174) for y in (-0.174, 0.174)),
    ],
    "iris": [
        (1.5, (0.0, 0.0, 0.0), (0.029125, 0.029125, 0.055225)),
        (0.015, (0.0, 0.0, 0.0), (1e-05, 1e-05, 1e-05)),
        (0.01, (0.0, 0.0, 0.0), (2.1733e-06, 2.1733e-06, 1.8e-07)),
        *((0.005, (0.13, y, 0.023), IRIS_BLADE) for y in (-0.22, 0.22)),
        *((0.005, (-0.13, y, 0.023), IRIS_BLADE) for y in (-0.2, 0.2)),
    ],
}


@pytest.mark.parametrize(("name", "write"), [("x500", x500), ("iris", iris)])
def test_an_sdf_weighs_what_the_engine_says_of_its_parts(name: str, write, tmp_path: Path) -> None:
    mass, com, inertia = composite(PARTS[name])
    body = import_robot(write(tmp_path)).robot.body
    assert body.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(body.com, com, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(body.inertia, inertia, rtol=0.0, atol=1e-9 * inertia.max())


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
