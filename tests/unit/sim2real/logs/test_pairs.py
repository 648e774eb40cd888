"""Logs of two vehicles in one flight: positions, clocks and refusals."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import ConfigError, DataError
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.learned import leave_out_flights
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.logs.flights import load_flights, read_flight_inputs
from aerial_gym.sim2real.logs.pairs import check_pairs, pair_logs
from aerial_gym.sim2real.logs.readers.flight_log import LogFlights, read_flights
from aerial_gym.sim2real.logs.recording import FlightLog, FrameOrigin, flight_numbers
from aerial_gym.sim2real.predict.scene import finding_on_absent_data
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, write


@pytest.fixture
def logs(tmp_path: Path) -> tuple[Path, Path]:
    first, second = (flight(seed, noise=1.0, seconds=6.0, rate=100.0) for seed in (1, 2))
    return write(first, tmp_path / "one.csv"), write(second, tmp_path / "two.csv")


def load(logs: tuple[Path, Path], clock: float = 0.0) -> list:
    pairs = pair_logs([logs], [clock])
    return load_flights(logs, ROBOT, mapping=None, bandwidth=10.0, pairs=pairs)


def test_each_log_has_the_place_of_the_other_vehicle(logs: tuple[Path, Path]) -> None:
    flights = load(logs)
    for own, other, vehicle in zip(flights, flights[::-1], (0, 1), strict=True):
        np.testing.assert_allclose(own.other_position, other.position, atol=1e-12)
        assert own.pair is not None
        assert (own.pair.pair, own.pair.vehicle, own.pair.clock) == (0, vehicle, 0.0)
    (note,) = (one for one in flights[0].notes if one.code == "flown_with")
    away = np.linalg.norm(flights[0].position - flights[1].position, axis=1)
    assert (note.values["share"], note.values["file"]) == (1.0, "two.csv")
    np.testing.assert_allclose((note.values["nearest_m"], note.values["farthest_m"]), (away.min(), away.max()))


def test_the_offset_of_the_second_clock_is_undone(logs: tuple[Path, Path]) -> None:
    """The second log is as before, but its clock shows 2.5 s less."""
    plain = load(logs)
    late = pd.read_csv(logs[1])
    write(late.assign(t=late["t"] - 2.5), logs[1])
    moved = load(logs, 2.5)
    for before, after in zip(plain, moved, strict=True):
        np.testing.assert_allclose(after.other_position, before.other_position, atol=1e-9)
        assert after.pair.clock == pytest.approx(before.pair.clock)


def test_clocks_that_differ_leave_rows_without_the_other_vehicle(logs: tuple[Path, Path]) -> None:
    first, second = load(logs, 2.0)
    assert np.isnan(first.other_position[:200]).all()
    np.testing.assert_allclose(first.other_position[200:], second.position[: first.num_rows - 200], atol=1e-9)
    np.testing.assert_allclose(second.other_position[: first.num_rows - 200], first.position[200:], atol=1e-9)


LAT, LON = 47.0, 8.0
METRE = 180.0 / (np.pi * 6378137.0)  # Degrees of a metre along a meridian


def test_local_frames_are_joined_by_their_origins(logs: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """The second frame begins 3 m east, 4 m north and 2 m above the first one. Without an origin nothing is known."""
    plain, unknown = load(logs), FrameOrigin()
    first = FrameOrigin(LAT, LON, 100.0)
    second = FrameOrigin(LAT + 4.0 * METRE, LON + 3.0 * METRE / np.cos(np.radians(LAT)), 102.0)
    origins: dict[str, FrameOrigin | None] = {}

    def read(paths: list, mapping: object) -> list:
        return [replace(log, origin=origins[Path(log.path).stem]) for log in read_flights(paths, mapping=mapping)]

    def with_origin(opened: LogFlights, number: int | None) -> FlightLog:
        return replace(original(opened, number), origin=origins[Path(opened.raw.path).stem])

    original = LogFlights.flight
    monkeypatch.setattr("aerial_gym.sim2real.logs.pairs.read_flights", read)
    monkeypatch.setattr(LogFlights, "flight", with_origin)
    origins.update(one=first, two=second)
    one, two = load(logs)
    np.testing.assert_allclose(
        one.other_position - plain[0].other_position, [[3.0, 4.0, 2.0]] * one.num_rows, atol=1e-6
    )
    np.testing.assert_allclose(
        two.other_position - plain[1].other_position, [[-3.0, -4.0, -2.0]] * one.num_rows, atol=1e-5
    )
    for pair in ((first, unknown), (first, None), (unknown, unknown)):
        origins.update(zip(("one", "two"), pair, strict=True))
        flights = load(logs)
        assert all(each.other_position is None and each.pair is not None for each in flights)
        assert "relative_position_unknown" in [note.code for note in flights[0].notes]
        lacking = finding_on_absent_data("downwash", EFFECTS.get("downwash").needs, [*flights, plain[0]])
        assert lacking is not None
        assert lacking.values["need"] == "other_position"


def test_both_logs_of_a_flight_are_one_flight_in_cross_validation(logs: tuple[Path, Path], tmp_path: Path) -> None:
    alone = write(flight(3, noise=1.0, seconds=6.0, rate=100.0), tmp_path / "three.csv")
    flights = load_flights([logs[0], alone, logs[1]], ROBOT, mapping=None, bandwidth=10.0, pairs=pair_logs([logs]))
    assert flight_numbers(flights).tolist() == [0, 1, 0]
    predictor = SimpleNamespace(flights=flights, times=[one.time for one in flights], channels=())
    weights = Weighting(variance=np.ones(1), effective=np.ones(1))
    made = leave_out_flights(predictor, weights, Criteria(), np.zeros(1))  # type: ignore[arg-type]
    first, other, second = np.split(made.fold_of_blocks, 3)
    assert set(first) == set(second) == {0}
    assert set(other) == {1}
    pair = SimpleNamespace(flights=flights[::2], times=[one.time for one in flights[::2]], channels=())
    folds = leave_out_flights(pair, weights, Criteria(), np.zeros(1)).fold_of_blocks  # type: ignore[arg-type]
    first, second = np.split(folds, 2)
    assert first.tolist() == second.tolist()  # both logs of one time are left out together
    assert len(set(first)) > 1


def test_rows_in_which_the_other_vehicle_is_unknown_are_not_compared(logs: tuple[Path, Path]) -> None:
    first, _ = load(logs, 2.0)
    excluded = first.rows_without_comparison(0)
    assert excluded is not None
    assert excluded.tolist() == [True] * 200 + [False] * (first.num_rows - 200)
    assert replace(first, pair=None).rows_without_comparison(0) is None


def test_pairs_that_cannot_be_used_are_refused_with_the_remedy(logs: tuple[Path, Path], tmp_path: Path) -> None:
    assert_refused(
        DataError, r"no time in common; give the offset of their clocks \(--pair-clock-s\)", load, logs, 100.0
    )
    bare = write(pd.read_csv(logs[1]).drop(columns=["p_x", "p_y", "p_z"]), tmp_path / "bare.csv")
    assert_refused(DataError, r"bare.csv: has no position", load, (logs[0], bare))
    one, two, three = (tmp_path / f"{name}.csv" for name in ("one", "two", "three"))
    with pytest.raises(ConfigError, match="not one log twice"):
        pair_logs([(one, tmp_path / "." / "one.csv")])
    with pytest.raises(ConfigError, match="has 2 offsets for 1 pairs"):
        pair_logs([(one, two)], [0.0, 1.0])
    with pytest.raises(ConfigError, match="must be finite"):
        pair_logs([(one, two)], [float("nan")])
    for message, pairs, train, test in (
        ("neither is in --train or --test", [(one, two)], [three], [three]),
        ("a flight is for training or for testing", [(one, two)], [one], [two]),
        ("two.csv is in another pair too", [(one, two), (two, three)], [one, two], [three]),
    ):
        with pytest.raises(ConfigError, match=message):
            check_pairs(pair_logs(pairs), train, test)
    check_pairs(pair_logs([(one, two)]), [one], [three])


def test_the_other_log_is_among_the_digests(logs: tuple[Path, Path], tmp_path: Path) -> None:
    test = write(flight(3, noise=1.0, seconds=6.0, rate=100.0), tmp_path / "test.csv")
    pairs = pair_logs([logs])
    inputs = read_flight_inputs(ROBOT, logs[:1], [test], mapping=None, bandwidth=10.0, pairs=pairs)
    assert set(inputs.digests) == {str(path) for path in (*logs, test)}
    assert [one.name for one in inputs.train] == ["one"]
    assert inputs.train[0].other_position is not None
