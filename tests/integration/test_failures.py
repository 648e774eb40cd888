"""Failures in flight, of an independent plant, are named with rotor, size and time; flights without one have none.
Beside small errors of mass, rotors, inertia, lag and sensors, which no failure is. Other seeds than those of any
development."""

import json
from pathlib import Path
from typing import Any

import pytest

from aerial_gym.physics.model import check_effects
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real import close_loop
from aerial_gym.sim2real.failures.flight_event import Failure, FailureFinder
from aerial_gym.sim2real.logs.flights import load_flights
from benchmarks.undeclared import PlantFailure as Hidden
from benchmarks.undeclared import make_case

HIDDEN = {
    "train_1": Hidden(kind="motor_failure", motor=1, scale=0.9, time=4.2),
    "train_2": Hidden(kind="stuck_rotor", motor=2, time=3.7),
    "train_3": Hidden(kind="brown_out", scale=0.85, time=5.03, duration=0.8),
    "test_1": Hidden(kind="weak_motor", motor=3, scale=0.9, time=4.9),
    "test_2": Hidden(kind="motor_failure", motor=4, scale=0.0, time=5.1),
}
"""One of the flights, ``train_4``, has none."""


@pytest.fixture(scope="module")
def flight_failures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Failure | None]:
    """Return the first failure found in each flight of one case, by flight name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("benchmarks.undeclared.simulate.SUBSTEPS", 2)  # as the fixture coarser_plant
        folder = tmp_path_factory.mktemp("failing")
        sizes = {"num_test": 2, "duration_s": 8.0, "rate_hz": 200, "nuisance": True}
        files = make_case(folder, effects={}, seed=731, failures=HIDDEN, **sizes)
    robot = robot_by_name(files.robot)
    finder = FailureFinder(robot)
    flights = load_flights([*files.train, *files.test], robot, mapping=None, bandwidth=10.0)
    return {flight.name: finder.find_first_failure(flight) for flight in flights}


@pytest.mark.parametrize("flight", HIDDEN)
def test_each_failure_is_named_with_rotor_size_and_time(flight, flight_failures) -> None:
    """Within four standard deviations; a stuck rotor has the speed that it had."""
    failure, hidden = flight_failures[flight], HIDDEN[flight].document()
    assert failure.name == hidden["kind"]
    assert failure.probability > 0.99
    for name in ("motor", "scale", "time"):
        if name in hidden:
            assert failure.params[name] == pytest.approx(hidden[name], abs=4.0 * failure.std.get(name, 0.0)), name
    if "duration" in hidden:
        assert failure.params["duration"] == pytest.approx(hidden["duration"], abs=0.02)


def test_a_flight_without_a_failure_has_none(flight_failures: dict[str, Failure | None]) -> None:
    assert flight_failures["train_4"] is None


def run_case(folder: Path, **case: Any) -> dict:
    files = make_case(folder / "case", num_train=2, num_test=2, duration_s=8.0, rate_hz=200, nuisance=True, **case)
    close_loop(files.robot, files.train, files.test, folder / "out", failures=True)
    check_effects(robot_by_name(folder / "out" / "robot.yaml"))
    return json.loads((folder / "out" / "verdict.json").read_text())


@pytest.mark.slow
def test_the_loop_names_a_failure_of_one_flight_beside_an_effect_of_all(coarser_plant: None, tmp_path: Path) -> None:
    hidden = {"train_2": Hidden(kind="motor_failure", motor=3, scale=0.85, time=5.0)}
    verdict = run_case(tmp_path, effects={"com_offset": "moderate"}, seed=732, failures=hidden)
    assert [effect["name"] for effect in verdict["effects"]] == ["com_offset"]
    assert [(one["flight"], one["name"]) for one in verdict["failures"]] == [("train_2", "motor_failure")]
    assert verdict["failures"][0]["params"] == pytest.approx({"motor": 3, "scale": 0.85, "time": 5.0}, abs=0.02)
    first = verdict["findings"][0]
    assert (first["code"], first["subject"], first["values"]["rotor"]) == ("failure_found", "train_2", 3)
    assert "motor_failure" not in robot_by_name(tmp_path / "out" / "robot.yaml").effects


@pytest.mark.slow
def test_the_robot_file_has_a_failure_that_every_flight_has(coarser_plant: None, tmp_path: Path) -> None:
    hidden = Hidden(kind="brown_out", scale=0.8, time=5.0, duration=0.5)
    flights = ("train_1", "train_2", "test_1", "test_2")
    verdict = run_case(tmp_path, effects={}, seed=733, failures=dict.fromkeys(flights, hidden))
    assert verdict["verdict"] == "explained"
    assert [effect["name"] for effect in verdict["effects"]] == ["brown_out"]
    kept = robot_by_name(tmp_path / "out" / "robot.yaml").effects["brown_out"]
    assert kept == pytest.approx({"scale": 0.8, "time": 5.0, "duration": 0.5}, abs=0.02)
