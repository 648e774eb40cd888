"""Repeated values: straight lines where a sensor is slow or late, a refusal where it froze, nothing where it stands still."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import FlightLog, read_flight_log
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.sample_repeats import mend_repeated_samples
from tests.unit.sim2real.flat_flights import flight, write

GYRO = ["omega_x", "omega_y", "omega_z"]
ATTITUDE = ["q_x", "q_y", "q_z", "q_w"]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(1, seconds=8.0, rate=200.0, noise=1.0)


def freeze(table: pd.DataFrame, columns: list[str], rows: np.ndarray) -> pd.DataFrame:
    values = table[columns].to_numpy().copy()
    for row in rows:
        values[row] = values[row - 1]
    return table.assign(**dict(zip(columns, values.T, strict=True)))


def mend(table: pd.DataFrame, folder: Path) -> FlightLog:
    return mend_repeated_samples(read_flight_log(write(table, folder / "a.csv")))


def test_a_good_log_stays_as_it_is(table: pd.DataFrame, tmp_path: Path) -> None:
    log = read_flight_log(write(table, tmp_path / "a.csv"))
    same = mend_repeated_samples(log)
    assert same.notes == log.notes
    for name in ("position", "attitude", "lin_vel", "ang_vel", "specific_force"):
        assert getattr(same, name) is getattr(log, name)


def test_a_slow_sensor_becomes_straight_lines_between_its_values(table: pd.DataFrame, tmp_path: Path) -> None:
    """A gyro of 50 Hz in a log of 200 Hz: every fourth row is as it was, those between lie on the lines."""
    log = mend(freeze(table, GYRO, np.setdiff1d(np.arange(1, len(table)), np.arange(0, len(table), 4))), tmp_path)
    (note,) = (note for note in log.notes if note.values.get("sensor") == "ang_vel")
    assert note.code == "samples_slow"
    assert (note.values["rate_hz"], note.values["log_rate_hz"]) == pytest.approx((50.0, 200.0), rel=1e-3)
    true = table[GYRO].to_numpy()
    np.testing.assert_allclose(log.ang_vel[::4], true[::4], atol=1e-9)
    np.testing.assert_allclose(log.ang_vel[2:-4:4], 0.5 * (true[:-4:4] + true[4::4]), atol=1e-9)


def test_late_packets_are_bridged_and_counted(table: pd.DataFrame, tmp_path: Path) -> None:
    late = np.flatnonzero(np.random.default_rng(0).random(len(table)) < 0.05)
    log = mend(freeze(table, ATTITUDE, late[late > 0]), tmp_path)
    note = next(note for note in log.notes if note.values.get("sensor") == "attitude")
    assert note.code == "samples_repeated"
    fresh = np.setdiff1d(np.arange(len(table)), late)
    signs = np.sign((log.attitude[fresh] * table[ATTITUDE].to_numpy()[fresh]).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(log.attitude[fresh] * signs, table[ATTITUDE].to_numpy()[fresh], atol=1e-9)
    middle = late[(late > 1) & (late < len(table) - 1)]
    assert np.all(np.any(log.attitude[middle] != log.attitude[middle - 1], axis=1))


def test_one_frozen_sensor_is_refused_where_it_froze(table: pd.DataFrame, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"line 402 .*: ang_vel repeats one value for 0\.3 s while the vehicle moves"):
        mend(freeze(table, GYRO, np.arange(400, 459)), tmp_path)
    mend(freeze(table, GYRO, np.arange(400, 440)), tmp_path)


def test_an_attitude_in_coarse_steps_is_not_frozen(table: pd.DataFrame, tmp_path: Path) -> None:
    """0.3 s at 0.12 rad/s are 0.036 rad: less than a step of a packed quaternion may be; at 0.3 rad/s they are not."""
    slow = freeze(table, ATTITUDE, np.arange(400, 460))
    slow.loc[399:460, GYRO] = [0.12, 0.0, 0.0]
    slow.loc[400:460:2, GYRO] = [0.1201, 0.0, 0.0]
    mend(slow, tmp_path)
    fast = slow.copy()
    fast.loc[399:460, GYRO] *= 2.5
    with pytest.raises(DataError, match="attitude repeats one value"):
        mend(fast, tmp_path)


def test_a_log_that_repeats_whole_rows_is_refused(table: pd.DataFrame, tmp_path: Path) -> None:
    rows = np.setdiff1d(np.arange(1, len(table)), np.arange(0, len(table), 3))
    with pytest.raises(DataError, match=r"67% of the rows repeat the one before; write each sample once, at its own t"):
        mend(freeze(table, [c for c in table.columns if c != "t"], rows), tmp_path)


def test_a_vehicle_at_rest_may_repeat_itself(table: pd.DataFrame, tmp_path: Path) -> None:
    still = table.copy()
    still.loc[:399, ["v_x", "v_y", "v_z", *GYRO]] = 0.0
    still.loc[:399, ATTITUDE] = still.loc[0, ATTITUDE].to_numpy()
    assert mend(still, tmp_path).notes == ()


def test_copies_of_a_row_are_left_out(table: pd.DataFrame, tmp_path: Path) -> None:
    twice = pd.concat((table[:100], table[99:100], table[100:]))
    log = read_flight_log(write(twice, tmp_path / "a.csv"))
    assert log.time.size == len(table)
    assert log.notes == (Finding("rows_copied", "", {"rows": 1}),)


def test_a_pose_that_repeats_all_along_a_short_log_is_said(table: pd.DataFrame, tmp_path: Path) -> None:
    short = table[:30].copy()
    short[["v_x", "v_y", "v_z"]] *= 0.11 / np.abs(short[["v_x", "v_y", "v_z"]].to_numpy()).max()
    short[["p_x", "p_y", "p_z"]] = short[["p_x", "p_y", "p_z"]].to_numpy()[0]
    log = mend(short, tmp_path)
    assert ("samples_repeated", "position") in [(note.code, note.values.get("sensor")) for note in log.notes]
