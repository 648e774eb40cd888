"""Filters, derivatives, resampling and the clock of the rotor log, against closed forms."""

import numpy as np
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.flight_log import FlightLog
from aerial_gym.sim2real.signals import (
    LARGEST_SHIFT_S,
    Lead,
    commands_lead_too,
    continuous_quaternion,
    edge_rows,
    lowpass,
    lowpass_gain,
    rotor_log_lead,
    shift_rotor_log,
    uniform_log,
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


def test_levels_and_slopes_pass_to_the_very_ends() -> None:
    line = (3.0 - 2.0 * TIME)[:, None]
    np.testing.assert_allclose(lowpass(line, RATE, BAND), line, atol=1e-5)
    np.testing.assert_allclose(lowpass(line, RATE, BAND, derivative=True), np.full_like(line, -2.0), atol=1e-3)


def test_the_filter_is_linear_and_columns_do_not_mix() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, TIME.size, 2))
    both = lowpass(2.0 * a - b, RATE, BAND)
    np.testing.assert_allclose(both, 2.0 * lowpass(a, RATE, BAND) - lowpass(b, RATE, BAND), atol=1e-12)
    np.testing.assert_allclose(lowpass(a[:, :1], RATE, BAND), lowpass(a, RATE, BAND)[:, :1], atol=1e-12)


def test_quaternions_become_unit_and_continuous() -> None:
    rng = np.random.default_rng(1)
    angle = np.cumsum(0.05 * rng.standard_normal(300))
    smooth = np.stack((np.sin(angle), 0 * angle, 0 * angle, np.cos(angle)), axis=1)
    found = continuous_quaternion(1.01 * smooth * rng.choice((-1.0, 1.0), (300, 1)))
    assert (found[1:] * found[:-1]).sum(axis=1).min() > 0.9
    np.testing.assert_allclose(np.abs((found * smooth).sum(axis=1)), 1.0)


def log(time: np.ndarray, **values: np.ndarray) -> FlightLog:
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1))
    return FlightLog(path="a.csv", time=time, attitude=attitude, **values)


def test_jitter_is_resampled_and_commands_stay_held() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    time[1:-1] += 0.004 * np.sin(np.arange(1, time.size - 1))
    step = np.where(time < 2.0, 100.0, 300.0)[:, None]
    found = uniform_log(log(time, position=np.stack((time, 2 * time, -time), axis=1), rotor_command=step))
    assert np.ptp(np.diff(found.time)) < 1e-12
    assert found.position is not None
    assert found.rotor_command is not None
    np.testing.assert_allclose(found.position[:, 1], 2.0 * found.time, atol=1e-12)
    assert set(np.unique(found.rotor_command)) == {100.0, 300.0}
    assert "resampled" in found.notes[0]
    with pytest.raises(DataError, match=r"0\.5 s after the row before, where 0\.01 s are usual; cut the log there"):
        uniform_log(log(np.delete(np.arange(0.0, 4.0, 0.01), np.arange(100, 149))))


def noise(rng: np.random.Generator, band: float) -> np.ndarray:
    return lowpass(rng.standard_normal((TIME.size, 1)), RATE, band)[:, 0]


def late(values: np.ndarray, rows: float) -> np.ndarray:
    """Return a periodic signal that comes so many rows later."""
    frequency = np.fft.rfftfreq(values.size)
    return np.fft.irfft(np.fft.rfft(values) * np.exp(-2j * np.pi * frequency * rows), n=values.size)


@pytest.mark.parametrize("lead", [-4.0, 0.0, 3.3])
def test_a_lead_of_the_rotor_log_is_found_with_its_spread(lead: float) -> None:
    """Drag along z and a lever arm must not look like a lead; a thrust that is off by 5 % neither. z is normal."""
    rng, found = np.random.default_rng(2), []
    for _ in range(200):
        thrust, climb, turning = 3.0 * noise(rng, 3.0), 2.0 * noise(rng, 0.5), 5.0 * noise(rng, 3.0)
        measured = 9.81 + 0.95 * thrust - 0.3 * climb + 0.004 * turning + 0.08 * rng.standard_normal(TIME.size)
        others = np.stack((climb, turning), axis=1)
        found.append(rotor_log_lead(measured, 9.81 + late(thrust, -lead), others, RATE, BAND))
    if lead == 0.0:
        assert all(one == Lead() for one in found)
        return
    z = np.array([(one.rows - lead) / one.std for one in found])
    assert abs(z.mean()) < 4.0 / np.sqrt(200)
    assert 0.85 < z.std() < 1.25


@pytest.mark.parametrize("lead", [-4.0, 2.0, 2.25])
def test_a_lead_is_undone(lead: float) -> None:
    speed = np.arange(TIME.size, dtype=float)[:, None]
    moved = shift_rotor_log(
        log(TIME, rotor_speed=speed, specific_force=np.repeat(speed, 3, axis=1)), Lead(rows=lead, std=0.1)
    )
    assert moved.rotor_speed is not None
    assert moved.specific_force is not None
    assert moved.time.size == TIME.size - np.ceil(abs(lead))
    np.testing.assert_allclose(moved.specific_force[:, 0] - moved.rotor_speed[:, 0], lead, atol=1e-9)
    assert f"{5.0 * lead:.3g} ± 0.98 ms" in moved.notes[-1]


@pytest.mark.parametrize("lead", [-4, 4])
@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("constant", [0.02, 0.03, 0.06])
def test_commands_move_with_the_rotor_log_only_if_a_lag_says_so(lead: int, *, together: bool, constant: float) -> None:
    """Whatever the lag is, 0.04 s as declared or not, it is no shift."""
    command = 900.0 + 40.0 * noise(np.random.default_rng(5), 15.0)
    speed, kept = command.copy(), np.exp(-1.0 / (RATE * constant))
    for row in range(1, TIME.size):
        speed[row] = kept * speed[row - 1] + (1.0 - kept) * command[row - 1]
    speed += np.random.default_rng(6).standard_normal(TIME.size)
    logged = log(
        TIME,
        rotor_speed=np.roll(speed, -lead)[:, None],
        rotor_command=np.roll(command, -lead if together else 0)[:, None],
    )
    ahead = Lead(rows=float(lead), std=0.1)
    assert commands_lead_too(logged, ahead, 0.04) is together
    moved = shift_rotor_log(logged, ahead, commands=together)
    assert moved.rotor_command is not None
    inner = slice(20, moved.time.size - 20)
    row = np.round(moved.time * RATE).astype(int)
    np.testing.assert_allclose(moved.rotor_command[inner, 0], command[row][inner])
    assert ("commands do not and stay" in moved.notes[0]) is not together


def test_a_signal_that_does_not_agree_at_all_is_not_shifted() -> None:
    rng = np.random.default_rng(3)
    assert rotor_log_lead(noise(rng, 3.0), noise(rng, 3.0), np.zeros((TIME.size, 0)), RATE, BAND) == Lead()


def test_a_lead_at_the_end_of_the_range_is_not_believed() -> None:
    """Something that lags by more than any clock, such as a load that swings below, is no offset of the rotor log."""
    rng = np.random.default_rng(4)
    thrust = 3.0 * noise(rng, 3.0)
    most = round(LARGEST_SHIFT_S * RATE)
    measured = 9.81 + np.roll(thrust, most) + 0.02 * rng.standard_normal(TIME.size)
    assert rotor_log_lead(measured, 9.81 + thrust, np.zeros((TIME.size, 0)), RATE, BAND) == Lead()
