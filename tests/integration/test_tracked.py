"""Logs as a motion-capture room has them, and as loggers write them: what is wrong with a log is no effect of a vehicle."""

from pathlib import Path

import pytest

from aerial_gym.env_manager.sim_builder import robot_by_name
from aerial_gym.sim2real.close_loop import judge_flights, load_train_and_test
from aerial_gym.sim2real.progress import silent
from benchmarks.undeclared import LOGGED, TRACKED, make_case


@pytest.mark.usefixtures("coarser_plant", "no_pixels")
@pytest.mark.parametrize("effects", [{}, {"rotor_drag": "moderate"}])
def test_neither_is_an_effect_of_the_vehicle(tmp_path: Path, effects: dict[str, str]) -> None:
    """What is hidden is named and nothing else; the notes say in what flights differ.

    Rules that knew neither gave this seed a misaligned sensor and a tilted motor.
    """
    files = make_case(tmp_path, effects=effects, seed=3602, nuisance=TRACKED, num_test=2, duration_s=10.0, rate_hz=200)
    robot = robot_by_name(files.robot)
    train, test = load_train_and_test(robot, files.train, files.test, None, 10.0, silent)
    verdict = judge_flights(robot, train, test, bandwidth=10.0).verdict
    assert [effect.name for effect in verdict.effects] == list(effects)
    assert verdict.verdict == ("explained" if effects else "none")
    assert "each flight has an offset of its own in specific_force" in verdict.reason
    assert any("offset of its own" in note and "specific_force" in note for note in verdict.notes)


@pytest.mark.usefixtures("coarser_plant", "no_pixels")
@pytest.mark.parametrize("effects", [{}, {"com_offset": "moderate"}])
def test_a_late_sensor_and_an_accelerometer_with_a_scale_and_a_place_are_not_either(
    tmp_path: Path, effects: dict[str, str]
) -> None:
    """The same of logs whose sensors are up to 6 ms late; rules that did not know it gave this seed four names and more."""
    files = make_case(tmp_path, effects=effects, seed=3810, nuisance=LOGGED, num_test=2, duration_s=10.0, rate_hz=200)
    robot = robot_by_name(files.robot)
    train, test = load_train_and_test(robot, files.train, files.test, None, 10.0, silent)
    verdict = judge_flights(robot, train, test, bandwidth=10.0).verdict
    assert [effect.name for effect in verdict.effects] == list(effects)
    assert verdict.verdict == ("explained" if effects else "none")
