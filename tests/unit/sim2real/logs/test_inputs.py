"""What a run reads: once, at its start, and without the flights that cannot be used."""

import hashlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.flights import read_flight_inputs
from tests.unit.sim2real.flat_flights import ROBOT, flight, write


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    return [write(flight(40 + n, noise=1.0, seconds=5.0, rate=100.0), tmp_path / f"f{n}.csv") for n in range(4)]


def spoil(path: Path) -> None:
    table = pd.read_csv(path)
    table.loc[100:110, "omega_y"] = np.nan
    write(table, path)


def test_a_flight_that_cannot_be_used_is_left_out_and_said_so(logs: list[Path]) -> None:
    spoil(logs[1])
    result = read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)
    assert [one.name for one in result.train] == ["f0", "f2"]
    assert [one.name for one in result.test] == ["f3"]
    (note,) = result.left_out
    assert note.code == "flight_left_out"
    assert note.values["error"].startswith(f"{logs[1]}, line 102: omega_y is empty")
    assert result.digests == {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in logs}


def test_a_flight_that_turns_otherwise_than_declared_is_left_out_too(logs: list[Path]) -> None:
    table = pd.read_csv(logs[0])
    write(table.rename(columns={"rotor_1": "rotor_2", "rotor_2": "rotor_1"}), logs[0])
    result = read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)
    assert [one.name for one in result.train] == ["f1", "f2"]
    assert "the probable order is rotor_2, rotor_1" in result.left_out[0].values["error"]


def test_a_run_that_has_no_flight_left_says_why(logs: list[Path]) -> None:
    spoil(logs[3])
    with pytest.raises(DataError, match=r"f3\.csv, line 102: omega_y is empty"):
        read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)
    for path in logs[:3]:
        spoil(path)
    words = r"f0\.csv, line 102: .*none of 3 flights to train on is left; the first .* of 4"
    with pytest.raises(DataError, match=words):
        read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)


def test_a_file_that_is_not_there_ends_the_run_at_its_start(logs: list[Path]) -> None:
    with pytest.raises(DataError, match=r"f9\.csv: no such file"):
        read_flight_inputs(ROBOT, [*logs[:2], logs[0].parent / "f9.csv"], logs[3:], mapping=None, bandwidth=10.0)
