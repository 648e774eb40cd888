"""Filters, derivatives and resampling against closed forms, and repeated values."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real import FlightLog, read_flight_log
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import take_rows
from aerial_gym.sim2real.logs.sample_repeats import mend_repeated_samples
from aerial_gym.sim2real.logs.signals import (
    apply_lag,
    continuous_quaternion,
    integrate_rates,
    log_at_equal_steps,
    lowpass,
    lowpass_gain,
    num_edge_rows,
    welch,
)
from tests.unit.sim2real.flat_flights import flight, write

RATE, BAND = 200.0, 10.0
TIME = np.arange(0.0, 10.0, 1.0 / RATE)
INNER = slice(2 * num_edge_rows(RATE, BAND), -2 * num_edge_rows(RATE, BAND))


@pytest.mark.parametrize("frequency", [0.3, 2.0, 8.0, 10.0, 14.0, 40.0])
def test_a_sine_keeps_its_phase_and_has_the_gain_of_the_filter(frequency: float) -> None:
    """sin goes to H sin, and its derivative to H w cos, with H = 1 / (1 + (f / b)^8); the ends leak less than 1 %."""
    angle, turn = 2.0 * np.pi * frequency * TIME + 0.4, 2.0 * np.pi * frequency
    wave, gain = np.sin(angle)[:, None], lowpass_gain(np.array([frequency]), BAND)[0]
    assert np.abs(lowpass(wave, RATE, BAND)[INNER, 0] - gain * np.sin(angle)[INNER]).max() < 0.01
    slope = lowpass(wave, RATE, BAND, derivative=True)[INNER, 0]
    assert np.abs(slope - gain * turn * np.cos(angle)[INNER]).max() < 0.01 * turn


@pytest.mark.parametrize("frequency", [0.3, 2.0, 8.0, 10.0, 14.0])
def test_what_comes_later_is_the_same_wave_at_another_time(frequency: float) -> None:
    """By 13 ms, 2.6 rows: sin goes to H sin of then, at the edge of the band as within it; 1 % leaks from the ends."""
    angle, gain = 2.0 * np.pi * frequency * TIME + 0.4, lowpass_gain(np.array([frequency]), BAND)[0]
    then = 2.0 * np.pi * frequency * (TIME - 0.013) + 0.4
    result = lowpass(np.sin(angle)[:, None], RATE, BAND, late=0.013)[INNER, 0]
    assert np.abs(result - gain * np.sin(then)[INNER]).max() < 0.01
    slope = lowpass(np.sin(angle)[:, None], RATE, BAND, derivative=True, late=0.013)[INNER, 0]
    turn = 2.0 * np.pi * frequency
    assert np.abs(slope - gain * turn * np.cos(then)[INNER]).max() < 0.01 * turn


def test_levels_and_slopes_pass_to_the_very_ends() -> None:
    line = (3.0 - 2.0 * TIME)[:, None]
    np.testing.assert_allclose(lowpass(line, RATE, BAND), line, atol=1e-5)
    np.testing.assert_allclose(lowpass(line, RATE, BAND, derivative=True), np.full_like(line, -2.0), atol=1e-3)


def test_the_filter_is_linear_and_columns_do_not_mix() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, TIME.size, 2))
    both = lowpass(2.0 * a - b, RATE, BAND)
    np.testing.assert_allclose(both, 2.0 * lowpass(a, RATE, BAND) - lowpass(b, RATE, BAND), atol=1e-12)
    for derivative in (False, True):  # bit for bit: what is filtered again must not differ by what else is
        alone = [lowpass(a[:, [k]], RATE, BAND, derivative=derivative) for k in range(2)]
        np.testing.assert_array_equal(np.concatenate(alone, axis=1), lowpass(a, RATE, BAND, derivative=derivative))


def test_quaternions_become_unit_and_continuous() -> None:
    rng = np.random.default_rng(1)
    angle = np.cumsum(0.05 * rng.standard_normal(300))
    smooth = np.stack((np.sin(angle), 0 * angle, 0 * angle, np.cos(angle)), axis=1)
    result = continuous_quaternion(1.01 * smooth * rng.choice((-1.0, 1.0), (300, 1)))
    assert (result[1:] * result[:-1]).sum(axis=1).min() > 0.9
    np.testing.assert_allclose(np.abs((result * smooth).sum(axis=1)), 1.0)


def log(time: np.ndarray, **values: np.ndarray) -> FlightLog:
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1))
    return FlightLog(path="a.csv", time=time, attitude=attitude, **values)


def test_jitter_is_resampled_and_commands_stay_held() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    time[1:-1] += 0.004 * np.sin(np.arange(1, time.size - 1))
    step = np.where(time < 2.0, 100.0, 300.0)[:, None]
    result = log_at_equal_steps(log(time, position=np.stack((time, 2 * time, -time), axis=1), rotor_command=step))
    assert np.ptp(np.diff(result.time)) < 1e-12
    np.testing.assert_allclose(result.position[:, 1], 2.0 * result.time, atol=1e-12)
    change = time[time >= 2.0][0]  # the row of the change has the mean of both commands
    row = result.time[1] - result.time[0]
    held = 100.0 * change + 300.0 * (result.time[-1] + row - change)
    assert result.rotor_command.sum() * row == pytest.approx(held, rel=1e-9)
    assert (np.abs(np.abs(result.rotor_command - 200.0) - 100.0) < 1e-9).sum() >= result.time.size - 1
    assert result.notes[0].code == "steps_resampled"
    with pytest.raises(DataError, match=r"0\.5 s after the row before, where 0\.01 s are usual; cut the log there"):
        log_at_equal_steps(log(np.delete(np.arange(0.0, 4.0, 0.01), np.arange(100, 149))))


@pytest.mark.parametrize(("rows", "segment"), [(2000, 400), (999, 111), (50, 50)])
def test_the_spectrum_is_that_of_welch(rows: int, segment: int) -> None:
    """As scipy has it, and the variance of white noise adds up."""
    values = np.random.default_rng(0).normal(size=(rows, 2))
    frequency, density = welch(values, RATE, segment)
    expected = signal.welch(values, RATE, nperseg=segment, detrend="linear", axis=0)
    np.testing.assert_allclose(frequency, expected[0])
    np.testing.assert_allclose(density, expected[1], rtol=1e-9)
    if rows > 1000:
        np.testing.assert_allclose(density.sum(axis=0) * frequency[1], 1.0, rtol=0.1)


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.999])
def test_a_lag_is_summed_as_row_by_row(kept: float) -> None:
    """``y_n = kept y_(n-1) + (1 - kept) x_(n-1)`` from a start of its own."""
    values, start = np.random.default_rng(0).normal(size=(300, 2)), np.array([3.0, -1.0])
    expected = [start]
    for row in values[:-1]:
        expected.append(kept * expected[-1] + (1.0 - kept) * row)
    np.testing.assert_allclose(apply_lag(values, kept, start), expected, atol=1e-13)


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


@pytest.mark.parametrize(("column", "message"), [("omega_y", "ang_vel 2"), ("rotor_3", "rotor_speed 3")])
def test_one_frozen_column_is_refused(column: str, message: str, table: pd.DataFrame, tmp_path: Path) -> None:
    """1.2 s of one value, where every other row has its own; in coarse steps a value may last as long."""
    with pytest.raises(
        DataError, match=rf"line 402 .*: {message} repeats one value for 1\.\d+ s while the vehicle moves"
    ):
        mend(freeze(table, [column], np.arange(400, 640)), tmp_path)
    mend(freeze(table, [column], np.arange(400, 580)), tmp_path)
    coarse = table.copy()
    coarse[column] = np.round(coarse[column] / np.ptp(coarse[column])) + 2.0
    mend(coarse, tmp_path)


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


def test_integrated_rates_equal_the_product_of_the_turns() -> None:
    """The blocks of the product end and begin with different turns; 103 samples fill no whole number of them."""
    time = np.cumsum(np.random.default_rng(0).uniform(0.001, 0.01, 103))
    rates = np.random.default_rng(1).normal(scale=20.0, size=(103, 3))
    expected = Rotation.identity()
    for k in range(102):
        expected *= Rotation.from_rotvec(0.5 * (rates[k] + rates[k + 1]) * (time[k + 1] - time[k]))
    attitude = integrate_rates(time, rates)
    assert (Rotation.from_quat(attitude[-1]).inv() * expected).magnitude() < 1e-12
    np.testing.assert_array_equal(attitude[0], (0.0, 0.0, 0.0, 1.0))


def test_white_noise_of_uneven_rows_stays_white() -> None:
    """Straight lines between rows would leave 0.7 of the density of white noise at a quarter of the rate, and 0.5 at 0.4."""
    rng = np.random.default_rng(0)
    time = 0.0025 * np.arange(20_000) + 1.5e-4 * rng.standard_normal(20_000)
    kept = np.ones(time.size, dtype=bool)
    kept[np.add.outer(rng.integers(1, 19_970, 50), np.arange(20)).ravel()] = False
    noise = rng.standard_normal((time.size, 3))
    log = FlightLog(path="a.csv", time=time, attitude=np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1)), ang_vel=noise)
    even = log_at_equal_steps(take_rows(log, kept))
    assert even.ang_vel is not None
    assert even.lost is not None
    frequency, density = welch(even.ang_vel[~even.lost], 400.0, 800)
    low, high = (density[(frequency > a) & (frequency < b)].mean() for a, b in ((10.0, 60.0), (80.0, 120.0)))
    assert high / low == pytest.approx(1.0, abs=0.1)
