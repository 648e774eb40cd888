"""Filters, derivatives and resampling, against closed forms."""

import numpy as np
import pytest
from scipy import signal

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.signals import (
    apply_lag,
    continuous_quaternion,
    edge_rows,
    interpolate_columns,
    lowpass,
    lowpass_gain,
    quaternion_signs,
    remove_line,
    uniform_log,
    welch,
)

RATE, BAND = 200.0, 10.0
TIME = np.arange(0.0, 10.0, 1.0 / RATE)
INNER = slice(2 * edge_rows(RATE, BAND), -2 * edge_rows(RATE, BAND))


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
    result = uniform_log(log(time, position=np.stack((time, 2 * time, -time), axis=1), rotor_command=step))
    assert np.ptp(np.diff(result.time)) < 1e-12
    np.testing.assert_allclose(result.position[:, 1], 2.0 * result.time, atol=1e-12)
    assert set(np.unique(result.rotor_command)) == {100.0, 300.0}
    assert result.notes[0].code == "steps_resampled"
    with pytest.raises(DataError, match=r"0\.5 s after the row before, where 0\.01 s are usual; cut the log there"):
        uniform_log(log(np.delete(np.arange(0.0, 4.0, 0.01), np.arange(100, 149))))


def test_without_line_is_what_a_fit_of_a_line_leaves() -> None:
    """Of each row by itself; scipy solves least squares for it."""
    values = np.cumsum(np.random.default_rng(0).normal(size=(3, 2, 50)), axis=-1)
    np.testing.assert_allclose(remove_line(values), signal.detrend(values, axis=-1), atol=1e-12)


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


def test_signs_take_every_jump_out_of_a_quaternion() -> None:
    turned = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.1, -1.0], [0.0, 0.0, 0.2, -1.0], [0.0, 0.0, -0.3, 1.0]])
    assert quaternion_signs(turned).tolist() == [1.0, -1.0, -1.0, 1.0]


def test_columns_run_in_straight_lines_between_rows() -> None:
    values = np.array([[0.0, 4.0], [2.0, 2.0], [2.0, 0.0]])
    assert interpolate_columns(np.array([0.5, 1.5]), np.arange(3.0), values).tolist() == [[1.0, 3.0], [2.0, 1.0]]
