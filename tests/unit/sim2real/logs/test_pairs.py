"""Logs of two vehicles in one flight: positions, clocks and refusals."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.logs.flights import load_flights, read_flight_inputs
from aerial_gym.sim2real.logs.pairs import check_pairs, pair_logs
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
