"""Faults of the IMU, injected into clean flights, are told by kinematics alone; a clean flight is silent."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real import FlightLog, read_flight_log
from aerial_gym.sim2real.logs.checks.conventions import check_log
from aerial_gym.sim2real.logs.checks.kinematics import ImuErrors, findings_on_gains, imu_errors_from_kinematics
from aerial_gym.sim2real.logs.signals import log_at_equal_steps
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

OMEGA, ACC = ["omega_x", "omega_y", "omega_z"], ["acc_x", "acc_y", "acc_z"]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(5, seconds=16.0, rate=200.0, noise=1.0)


def read_log(table: pd.DataFrame, folder: Path) -> FlightLog:
    return log_at_equal_steps(read_flight_log(write(table, folder / "a.csv")))


def errors(table: pd.DataFrame, folder: Path, sensor: str) -> ImuErrors:
    return next(a for a in imu_errors_from_kinematics(read_log(table, folder)) if a.sensor == sensor)


@pytest.mark.parametrize("seed", [1, 5, 6])
def test_a_clean_flight_is_silent(seed: int, tmp_path: Path) -> None:
    clean = flight(seed, seconds=16.0, rate=200.0, noise=1.0)
    assert [note for a in imu_errors_from_kinematics(read_log(clean, tmp_path)) for note in a.findings()] == []


@pytest.mark.parametrize("size", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_bias_of_the_gyro(table: pd.DataFrame, tmp_path: Path, size: float, sign: float) -> None:
    changed = table.assign(omega_y=table["omega_y"] + sign * size)
    result = errors(changed, tmp_path, "gyro")
    np.testing.assert_allclose(result.bias, (0.0, sign * size, 0.0), atol=0.003)
    assert [(note.code, note.values["sensor"]) for note in result.findings()] == [("sensor_bias", "gyro")]


@pytest.mark.parametrize("size", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_bias_of_the_accelerometer(table: pd.DataFrame, tmp_path: Path, size: float, sign: float) -> None:
    changed = table.assign(acc_z=table["acc_z"] + sign * size)
    result = errors(changed, tmp_path, "accelerometer")
    assert result.bias[2] == pytest.approx(sign * size, abs=0.05)
    assert result.bias[2] - result.half_width[2] < sign * size < result.bias[2] + result.half_width[2]
    assert ("sensor_bias", "accelerometer") in [(note.code, note.values["sensor"]) for note in result.findings()]


@pytest.mark.parametrize(("columns", "sensor", "axis"), [(OMEGA, "gyro", 2), (ACC, "accelerometer", 0)])
@pytest.mark.parametrize("degrees", [-8.0, -3.0, 3.0, 8.0])
def test_a_turned_sensor(table, tmp_path, columns, sensor, axis, degrees) -> None:
    turn = Rotation.from_euler("xyz"[axis], degrees, degrees=True)
    changed = table.copy()
    changed[columns] = turn.inv().apply(table[columns].to_numpy(copy=True))
    result = errors(changed, tmp_path, sensor)
    assert np.degrees(result.angle[axis]) == pytest.approx(degrees, abs=0.05 * abs(degrees) + 0.3)
    assert "sensor_turned" in [note.code for note in result.findings()]


@pytest.mark.parametrize("factor", [0.94, 1.0, 1.06])
def test_gravity_shows_the_gain_of_an_accelerometer_beside_a_slow_velocity(
    table, tmp_path: Path, factor: float
) -> None:
    """The velocity comes at 2.5 Hz, too rarely for the motion to show the gain."""
    changed, time, rare = table.assign(acc_z=factor * table["acc_z"]), table["t"], slice(None, None, 80)
    for name in ("v_x", "v_y", "v_z"):
        changed[name] = np.interp(time, time[rare], table[name][rare])
    gains = [note.values for note in findings_on_gains(read_log(changed, tmp_path)) if note.values["column"] == "acc_z"]
    assert len(gains) == (factor != 1.0)
    for values in gains:
        assert values["half_width_ratio"] < 0.02
        assert values["gain_ratio"] == pytest.approx(factor, abs=values["half_width_ratio"])


def test_what_a_flight_cannot_show_is_not_told(table: pd.DataFrame, tmp_path: Path) -> None:
    result = errors(table, tmp_path, "accelerometer")
    assert np.isinf(result.half_width[5])
    assert np.isfinite(result.half_width[:5]).all()


@pytest.mark.parametrize(("columns", "sensor"), [(OMEGA, "gyro"), (ACC, "accelerometer")])
@pytest.mark.parametrize("rows", [-6, -2, 2, 6])
def test_a_late_or_early_sensor(table, tmp_path, columns, sensor, rows) -> None:
    """Rows of 5 ms; a sensor that is late shows now what was before."""
    changed = table.copy()
    changed[columns] = np.roll(table[columns].to_numpy(), rows, axis=0)
    changed = changed.iloc[10:-10].reset_index(drop=True)
    result = errors(changed, tmp_path, sensor)
    assert result.delay == pytest.approx(0.005 * rows, rel=0.15)
    word = "late" if rows > 0 else "early"
    (note,) = (note for note in result.findings() if note.code == "sensor_late")
    assert (note.values["late_ms"] > 0.0) == (word == "late")


def test_faults_of_the_imu_stand_in_the_notes_of_a_check(table: pd.DataFrame, tmp_path: Path) -> None:
    changed = table.assign(omega_x=table["omega_x"] - 0.1)
    (note,) = (note for note in check_log(read_log(changed, tmp_path), ROBOT) if note.code == "sensor_bias")
    assert note.values["bias_rad_s"][0] == pytest.approx(-0.1, abs=0.01)


def test_a_drag_the_model_lacks_is_no_fault_of_the_imu(tmp_path: Path) -> None:
    draggy = flight(5, seconds=16.0, rate=200.0, noise=1.0, drag=0.3)
    assert [note for a in imu_errors_from_kinematics(read_log(draggy, tmp_path)) for note in a.findings()] == []
