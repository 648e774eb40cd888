"""A copy of a flight is no other flight, whatever was done to the file."""

from pathlib import Path

import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.checks.copies import LogRegister
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.logs.inputs import read_flight_inputs
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from tests.unit.sim2real.flat_flights import ROBOT, flight, write


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(1, seconds=8.0, rate=100.0, noise=1.0)


@pytest.mark.parametrize(
    ("change", "share"),
    [
        (lambda t: t, "100%"),
        (lambda t: t.assign(t=t["t"] + 1.7e9), "100%"),
        (lambda t: t[250:600].assign(t=t["t"] - 2.5), "100%"),
        (lambda t: t[::2], "100%"),
        (lambda t: t.drop(columns=["v_x", "v_y", "v_z", "acc_x", "acc_y", "acc_z"]), "100%"),
        (lambda t: t[list(t.columns[::-1])].assign(vbat=11.1), "100%"),
        (lambda t: pd.concat((t[400:], flight(2, seconds=4.0, rate=100.0).assign(t=lambda f: f["t"] + 8.0))), "50%"),
    ],
)
def test_a_copy_is_refused(table: pd.DataFrame, tmp_path: Path, change: object, share: str) -> None:
    first, second = write(table, tmp_path / "a.csv"), tmp_path / "b.csv"
    write(change(table), second)
    seen = LogRegister()
    seen.add(read_flight_log(first))
    with pytest.raises(DataError, match=rf"b\.csv: {share} of the measurements are those of .*a\.csv, value by value"):
        seen.add(read_flight_log(second))


def test_a_test_flight_that_is_a_copy_is_left_out(table: pd.DataFrame, tmp_path: Path) -> None:
    paths = [write(table, tmp_path / name) for name in ("train.csv", "copy.csv")]
    other = write(flight(2, seconds=8.0, rate=100.0, noise=1.0), tmp_path / "other.csv")
    with pytest.raises(DataError, match="a copy is no other flight"):
        load_flights(paths, ROBOT, mapping=None, bandwidth=10.0)
    result = read_flight_inputs(ROBOT, paths[:1], [paths[1], other], mapping=None, bandwidth=10.0)
    assert [one.name for one in result.test] == ["other"]
    assert "a copy is no other flight" in result.left_out[0].values["error"]
    with pytest.raises(DataError, match="give each flight once, to train or to test"):
        read_flight_inputs(ROBOT, paths[:1], paths[1:], mapping=None, bandwidth=10.0)


def test_flights_that_begin_alike_or_rest_alike_are_different(table: pd.DataFrame, tmp_path: Path) -> None:
    logs = [table, *(flight(n, seconds=8.0, rate=100.0, noise=1.0) for n in (2, 3, 4))]
    logs[1][:50] = table[:50]
    for rests in logs[2:]:
        rests.loc[:300, table.columns[1:]] = 1.0
    seen = LogRegister()
    for number, one in enumerate(logs):
        seen.add(read_flight_log(write(one, tmp_path / f"{number}.csv")))
