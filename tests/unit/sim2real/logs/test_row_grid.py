"""Streams on the samples of the gyro: attitude on the sphere, commands held, faster sensors averaged."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.logs.flight_spans import FlightSpan
from aerial_gym.sim2real.logs.raw_log import LogChannel
from aerial_gym.sim2real.logs.row_grid import resample_streams, row_times
from aerial_gym.sim2real.logs.signals import welch
from aerial_gym.sim2real.logs.streams import Stream

SPAN = FlightSpan(start=1.0, end=3.0, ended_by="log_end")


def stream(name: str, rate: float, values: np.ndarray | None = None) -> Stream:
    time = np.arange(round(4.0 * rate) + 1) / rate
    table = np.zeros((time.size, 3)) if values is None else values
    return Stream(channel=LogChannel(quantity=name, time=time, values=table, source=name), time=time, values=table)


@pytest.mark.parametrize(("gyro", "rate"), [(100.0, 100.0), (50.0, 50.0), (25.0, 200.0), (8000.0, 2000.0)])
def test_the_gyro_gives_the_rows_from_50_to_2000_hz(gyro: float, rate: float) -> None:
    """A slower gyro gives way to the fastest stream of motion, a faster one is thinned."""
    rows = row_times({"ang_vel": stream("ang_vel", gyro), "rotor_command": stream("rotor_command", 200.0)}, SPAN)
    assert (rows[0], rows[-1]) == (pytest.approx(1.0), pytest.approx(3.0))
    np.testing.assert_allclose(np.diff(rows), 1.0 / rate)


def test_attitude_at_20_hz_follows_a_steady_turn_exactly() -> None:
    slow = stream("attitude", 20.0)
    turn = np.array([0.3, 2.0, 1.0])
    slow = stream("attitude", 20.0, Rotation.from_rotvec(turn * slow.time[:, None]).as_quat())
    rows = np.arange(1.0, 3.0, 0.005)
    resampled = Rotation.from_quat(resample_streams({"attitude": slow}, rows)["attitude"])
    assert (Rotation.from_rotvec(turn * rows[:, None]).inv() * resampled).magnitude().max() < 1e-9


def test_fast_commands_are_averaged_over_a_row_and_slow_ones_interpolated() -> None:
    """A held command that changes within a row has its share of the row, and is neither late nor early."""
    fast, slow = stream("rotor_command", 100.0), stream("rotor_command", 10.0)
    rows = np.arange(1.0, 3.0, 0.004)
    held = resample_streams({"rotor_command": stream("rotor_command", 100.0, fast.time[:, None])}, rows)[
        "rotor_command"
    ]
    fine = np.floor((rows[:, None] + np.arange(0.5, 8.0) * 5e-4) * 100.0) / 100.0
    np.testing.assert_allclose(held[:, 0], fine.mean(axis=1), atol=1e-9)
    line = resample_streams({"rotor_command": stream("rotor_command", 10.0, slow.time[:, None])}, rows)["rotor_command"]
    np.testing.assert_allclose(line[:, 0], rows, atol=1e-12)


def test_a_faster_accelerometer_is_averaged_and_rows_of_one_clock_stay_as_they_are() -> None:
    """The mean of alternating 0 and 2 is 1; a line stays a line."""
    fast = stream("specific_force", 1000.0)
    wave = np.stack((fast.time, 2.0 * (np.arange(fast.time.size) % 2), np.zeros(fast.time.size)), axis=1)
    rows = np.arange(1.0, 3.0, 0.01) + 0.0005
    values = resample_streams({"specific_force": stream("specific_force", 1000.0, wave)}, rows)["specific_force"]
    np.testing.assert_allclose(values[:, 0], rows, atol=1e-9)
    np.testing.assert_allclose(values[:, 1], 1.0, atol=0.21)  # the local slope of such a wave is no trend
    own = stream("ang_vel", 1000.0, wave)
    np.testing.assert_array_equal(resample_streams({"ang_vel": own}, own.time[5:-5])["ang_vel"], wave[5:-5])


def test_rotor_speeds_between_rows_keep_noise_and_motion() -> None:
    """Lines would lose 40 % of the noise from 15 to 60 Hz, by which the noise floor is measured."""
    white = np.random.default_rng(0).standard_normal((801, 3))
    white[:, 2] = np.sin(2.0 * np.pi * 40.0 * np.arange(801) / 200.0)
    rows = np.arange(1.0, 3.0, 0.005) + 0.0025
    values = resample_streams({"rotor_speed": stream("rotor_speed", 200.0, white)}, rows)["rotor_speed"]
    density = [welch(one[:, :2], 200.0, 100)[1][8:31].mean() for one in (values, white[200:601])]
    assert density[0] / density[1] == pytest.approx(1.0, abs=0.07)
    np.testing.assert_allclose(values[20:-20, 2], np.sin(2.0 * np.pi * 40.0 * rows[20:-20]), atol=0.02)
