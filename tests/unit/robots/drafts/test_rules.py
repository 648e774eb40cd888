"""Rules of thumb for a robot: against published measurements, and against the equation behind a rule."""

from math import pi, sqrt

import numpy as np
import pytest

from aerial_gym.config import load
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.robots.check import check_robot
from aerial_gym.robots.drafts.draft import robot_yaml_with_origins
from aerial_gym.robots.drafts.rules import draft_robot
from tests.refusals import assert_refused

VEHICLES = {
    "whoop": (
        {"mass": 0.025, "arm": 0.0325, "propeller": "1.22x0.9x4", "motor_kv": 22000, "battery": "1S300"},
        2.5,
        5.0,
    ),
    "three_inch": ({"mass": 0.25, "arm": 0.07, "propeller": "3x2.5x3", "motor_kv": 3800, "battery": "4S650"}, 4.0, 9.0),
    "five_inch": ({"mass": 0.7, "arm": 0.11, "propeller": "5x4.3x3", "motor_kv": 1750, "battery": "6S1300"}, 6.0, 12.0),
    "seven_inch": ({"mass": 1.5, "arm": 0.15, "propeller": "7x4", "motor_kv": 1300, "battery": "6S3000"}, 3.0, 7.0),
    "hexarotor": (
        {"mass": 6.0, "propeller": "15x5.5", "motor_kv": 400, "battery": "6S16000", "frame": "hexa_x"},
        2.0,
        4.0,
    ),
}
"""Options, and the thrust-to-weight ratios that such vehicles have."""

LAGS = {"whoop": (0.03, 0.1), "three_inch": (0.02, 0.05), "five_inch": (0.02, 0.045), "seven_inch": (0.025, 0.07)}
LAGS |= {"hexarotor": (0.05, 0.12)}


@pytest.mark.parametrize("name", VEHICLES)
def test_vehicles_of_five_sizes_are_plausible(name: str, tmp_path) -> None:
    options, least, most = VEHICLES[name]
    draft = draft_robot(**options)
    (tmp_path / "robot.yaml").write_text(robot_yaml_with_origins(draft, name=name), encoding="utf-8")
    robot = load(RobotCfg, tmp_path / "robot.yaml")
    report = check_robot(robot, name=name, controllers=())
    assert (report.problems, report.warnings) == ((), ())
    assert least < report.thrust_to_weight < most
    assert LAGS[name][0] < robot.rotor.time_constant_up < LAGS[name][1]
    assert (
        0.005 < robot.rotor.torque_ratio / (2.0 * robot.rotor.radius) * 0.127 < 0.02
    )  # of a 5-inch propeller: 0.010 to 0.015
    assert all(value.kind in ("given", "assumed") for value in draft.values.values())


MEASURED = {
    "9.4x5.0": (920, "4S", 9068, 1024), "8x4.5": (920, "4S", 9722, 891), "15x5.5": (320, "6S", 5832, 2545),
    "15x7.5": (320, "6S", 6376, 2373), "11x4.7": (780, "4S", 8951, 1876), "11x5.5": (780, "4S", 9168, 1576),
    "11x5": (780, "4S", 9159, 1538), "10x4.5": (780, "4S", 9836, 1546),
}  # fmt: skip
"""CTU in Prague, Multi-robot Systems group, motor tests: motor [rpm/V], full battery, speed [rpm] and thrust [g] at full
command, by propeller."""


def test_thrusts_are_those_of_measured_propellers() -> None:
    """The median is right within 15 %, at the measured speed and from motor and battery, and no thrust is wrong by half."""
    ratios = []
    for propeller, (motor_kv, battery, speed, thrust) in MEASURED.items():
        v = draft_robot(mass=0.5, propeller=propeller, motor_kv=motor_kv, battery=battery).values
        turned = v["thrust"].value * (speed * 2.0 * pi / 60.0) ** 2
        ratios.append(np.array((turned, v["largest_thrust"].value)) / (thrust * 9.81e-3))
    assert np.abs(np.median(ratios, axis=0) - 1.0).max() < 0.15
    assert (np.abs(np.log(ratios)) < np.log(1.5)).all()


def test_torque_ratio_is_that_of_a_measured_five_inch_propeller() -> None:
    """The bench of the Aerial Gym Simulator has 0.0142 m at 3.5 N."""
    assert draft_robot(mass=0.7, propeller="5x4.3x3").values["torque_ratio"].value == pytest.approx(0.0142, rel=0.3)


def test_lag_is_that_of_a_simulated_motor_about_hover() -> None:
    """A DC motor with a rod as propeller answers a small step of the voltage; its time to 63 % is the lag."""
    v = {name: each.value for name, each in draft_robot(**VEHICLES["five_inch"][0]).values.items()}
    drag, full = v["torque_ratio"] * v["thrust"], sqrt(v["largest_thrust"] / v["thrust"])
    inertia = 0.096 * v["blades"] * (2.0 * v["radius"]) ** 4 / 12.0
    stiffness = drag * full**2 / (full / 0.73 - full)  # torque per missing speed at full command

    def settle(speed: float, command: float, seconds: float) -> np.ndarray:
        speeds = [speed]
        for _ in range(round(seconds / 1e-5)):
            speeds.append(speeds[-1] + 1e-5 * (stiffness * (command - speeds[-1]) - drag * speeds[-1] ** 2) / inertia)
        return np.array(speeds)

    hover = sqrt(0.7 * 9.81 / 4.0 / v["thrust"])
    command = hover + drag * hover**2 / stiffness
    answer = settle(hover, command * 1.01, 0.3)
    reached = np.flatnonzero(answer - hover > (1.0 - np.exp(-1.0)) * (answer[-1] - hover))[0]
    assert reached * 1e-5 == pytest.approx(v["lag"], rel=0.02)


def test_missing_parts_are_assumed_and_say_so() -> None:
    values = draft_robot(mass=1.0).values
    assert {name for name, each in values.items() if not each.is_assumed} == {"mass"}
    assert values["largest_thrust"].value == pytest.approx(2.0 * 9.81 / 4.0)
    assert draft_robot(mass=1.0, max_thrust=7.0).values["largest_thrust"].origin == "given: --max-thrust-n"
    assert (
        draft_robot(mass=1.0, battery="4S").values["capacity"].origin
        == "assumed: a quarter of the mass, with 150 W h/kg"
    )


def test_all_wrong_options_are_named_at_once() -> None:
    words = r"(?s)^5 faults:.*--mass-kg -1: .*--motor-kv 0: .*--propeller 5 inch: .*--battery six: .*--frame y6: has two rotors"
    options = {"mass": -1.0, "motor_kv": 0.0, "propeller": "5 inch", "battery": "six", "frame": "y6"}
    assert_refused(ConfigError, words, draft_robot, **options)
    assert_refused(
        ConfigError, "gives 1.2 N at most, and carries 2.45 N at hover", draft_robot, mass=1.0, max_thrust=1.2
    )
    assert_refused(UnknownNameError, "no frame 'quadx'. Did you mean 'quad_x'", draft_robot, mass=1.0, frame="quadx")
