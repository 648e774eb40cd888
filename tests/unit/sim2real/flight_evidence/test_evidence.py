"""Evidence of single flights: independent of the batch, additive, and complete for bad logs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.flight_evidence import evidence
from aerial_gym.sim2real.flight_evidence.columns import evidence_columns
from aerial_gym.sim2real.flight_evidence.evidence import (
    FlightEvidence,
    RefusedFlight,
    flight_evidences,
    model_version,
)
from aerial_gym.sim2real.flight_evidence.moments import FlightSums, sums_of_flights
from aerial_gym.sim2real.flight_evidence.reading import LONGEST_PART_S, flight_parts
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from benchmarks.undeclared import make_case

Case = tuple[RobotCfg, tuple[Path, ...]]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Return a robot with five logs of 6 s of which the third breaks off in its header."""
    folder = tmp_path_factory.mktemp("case")
    files = make_case(
        folder, effects={"weak_motor": "large"}, seed=4, num_train=3, num_test=2, duration_s=6.0, nuisance=True,
        features=("battery",), logger="gps",
    )  # fmt: skip
    logs = (*files.train, *files.test)
    logs[2].write_bytes(logs[2].read_bytes()[:100])
    return robot_by_name(files.robot), logs


@pytest.fixture(scope="module")
def results(case: Case) -> list[FlightEvidence | RefusedFlight]:
    """Return the evidence of all logs from one call."""
    return flight_evidences(*case)


def assert_same(one: FlightEvidence | RefusedFlight, other: FlightEvidence | RefusedFlight) -> None:
    """Compare every bit of two results."""
    assert type(one) is type(other)
    for name, value in vars(one).items():
        np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)


@pytest.mark.parametrize("order", [(0,), (4,), (2, 3), (1, 0), (4, 3, 2, 1, 0)])
def test_a_result_does_not_depend_on_the_other_logs_of_a_call(
    case: Case, results: list[FlightEvidence | RefusedFlight], order: tuple[int, ...]
) -> None:
    robot, logs = case
    for place, one in zip(order, flight_evidences(robot, [logs[k] for k in order]), strict=True):
        assert_same(one, results[place])


def test_a_broken_log_is_refused_with_the_reason_of_its_reader(
    results: list[FlightEvidence | RefusedFlight], case: Case
) -> None:
    refused = [one for one in results if isinstance(one, RefusedFlight)]
    assert len(refused) == 1
    assert results[2] is refused[0]
    assert refused[0].reason.startswith("holds neither attitude nor angular velocity")
    assert str(case[1][2].parent) not in refused[0].reason


@pytest.mark.parametrize("content", [b"", b"t,p_x\n0,nan\n", b"\x00" * 5000])
def test_any_bad_file_is_refused(case: Case, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    results = flight_evidences(case[0], [path, tmp_path / "missing.ulg"])
    assert all(isinstance(one, RefusedFlight) and one.reason for one in results)


def test_a_path_does_not_change_a_result(
    case: Case, results: list[FlightEvidence | RefusedFlight], tmp_path: Path
) -> None:
    moved = tmp_path / "some other name.ulg"
    moved.write_bytes(case[1][0].read_bytes())
    assert_same(flight_evidences(case[0], [moved])[0], results[0])


def test_the_hidden_weak_rotor_has_the_strongest_evidence(results: list[FlightEvidence | RefusedFlight]) -> None:
    flights = [one for one in results if isinstance(one, FlightEvidence)]
    total = dict.fromkeys(((one.effect, one.rotor, one.start) for one in flights[0].effects), 0.0)
    for flight in flights:
        for one in flight.effects:
            total[one.effect, one.rotor, one.start] += one.score
    assert max(total, key=total.__getitem__)[0] in ("weak_motor", "motor_gain", "com_offset")


def test_columns_are_the_same_for_all_flights_and_none_is_hidden_by_scale(
    case: Case, results: list[FlightEvidence | RefusedFlight]
) -> None:
    columns = evidence_columns(case[0], Tolerances())
    for one in (one for one in results if isinstance(one, FlightEvidence)):
        assert one.columns == columns
        assert one.product.shape == (len(columns), len(columns))
        assert one.gradient.shape == (len(columns),)
        np.testing.assert_allclose(one.product, one.product.T, rtol=1e-6)
        assert np.linalg.eigvalsh(one.product).min() > -1e-6 * np.linalg.eigvalsh(one.product).max()


def test_a_wrong_request_is_no_refused_flight(case: Case) -> None:
    with pytest.raises(ConfigError, match="bandwidth_hz"):
        flight_evidences(*case, bandwidth=0.0)


def test_the_version_of_the_model_names_the_source() -> None:
    number, _, digest = model_version().partition("+")
    assert number[0].isdigit()
    assert len(digest) == 12


def test_a_flight_that_cannot_be_predicted_refuses_its_log_alone(
    case: Case, results: list[FlightEvidence | RefusedFlight], monkeypatch: pytest.MonkeyPatch
) -> None:
    def sums_or_error(predictor: Predictor, bounds: tuple[Array, Array]) -> list[FlightSums]:
        if any(flight.name == "train_2" for flight in predictor.flights):
            raise ValueError("a fault of this flight")
        return sums_of_flights(predictor, bounds)

    monkeypatch.setattr(evidence, "sums_of_flights", sums_or_error)
    robot, logs = case
    first, second = flight_evidences(robot, logs[:2])
    assert_same(first, results[0])
    assert second == RefusedFlight(reason="cannot be read (ValueError: a fault of this flight)")


def test_a_long_flight_is_compared_in_parts_of_equal_length(case: Case) -> None:
    (flight,) = load_flights([case[1][0]], case[0], mapping=None, bandwidth=10.0)
    parts = flight_parts(replace(flight, time=flight.time * (700.0 / flight.time[-1])))
    assert len(parts) == 3
    assert all(part.time[0] == 0.0 and part.time[-1] < LONGEST_PART_S for part in parts)
    np.testing.assert_array_equal(np.concatenate([part.ang_vel for part in parts]), flight.ang_vel)
