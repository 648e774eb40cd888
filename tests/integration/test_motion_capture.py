"""Logs as a motion-capture room has them, and as loggers write them: what is wrong with a log is no effect of a vehicle."""

from pathlib import Path

import pytest

from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.logs.flights import load_train_and_test
from aerial_gym.sim2real.loop import judge_flights
from benchmarks.undeclared import LOGGED, TRACKED, make_case
from benchmarks.undeclared.sensors import PlantNuisance

SHORT = {"num_test": 2, "duration_s": 10.0, "rate_hz": 200}


def judge_case(
    folder: Path, effects: dict[str, str], seed: int, errors: PlantNuisance, size: dict[str, int | float] = SHORT
) -> Verdict:
    """Return the closed loop's verdict on a case, short by default, which must name exactly the hidden effects."""
    files = make_case(folder, effects=effects, seed=seed, nuisance=errors, **size)
    robot = robot_by_name(files.robot)
    train, test = load_train_and_test(robot, files.train, files.test, None, 10.0)
    verdict = judge_flights(robot, train, test, bandwidth=10.0).verdict
    assert [effect.name for effect in verdict.effects] == list(effects)
    assert verdict.verdict == ("explained" if effects else "none")
    return verdict


@pytest.mark.slow
@pytest.mark.usefixtures("coarser_plant")
@pytest.mark.parametrize("effects", [{}, {"rotor_drag": "moderate"}])
def test_neither_is_an_effect_of_the_vehicle(tmp_path: Path, effects: dict[str, str]) -> None:
    """The notes say in what flights differ. Rules that knew neither gave this seed a misaligned sensor and a tilted
    motor."""
    verdict = judge_case(tmp_path, effects, 3602, TRACKED)
    (point,) = (one for one in verdict.open_points if one.code == "offsets_of_flights")
    assert any(channel.startswith("specific_force") for channel in point.values["channels"])
    (note,) = (one for one in verdict.notes if one.code == "offsets_sizes")
    assert any(row["channel"].startswith("specific_force") for row in note.values["offsets"])


@pytest.mark.slow
@pytest.mark.usefixtures("coarser_plant")
@pytest.mark.parametrize("effects", [{}, {"com_offset": "moderate"}])
def test_a_late_sensor_and_an_accelerometer_with_a_scale_and_a_place_are_not_either(tmp_path, effects) -> None:
    """The same of logs whose sensors are up to 6 ms late; rules that did not know it gave this seed four names and more."""
    judge_case(tmp_path, effects, 3810, LOGGED)


@pytest.mark.slow
def test_an_early_gyro_beside_a_far_accelerometer_is_no_soft_joint(tmp_path: Path) -> None:
    """Deviations of 4 ms and 1 cm that act on each other; linear ones named a soft joint beside the inertia of the
    rotors. Short flights do not show it."""
    judge_case(tmp_path, {"rotor_inertia": "moderate"}, 3816, LOGGED, size={})
