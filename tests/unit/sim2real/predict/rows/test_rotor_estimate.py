"""Rotor speeds without the part of their noise that a fit would take for motion, and answers of an autopilot to noise."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch

from aerial_gym.physics import vehicle_from_config
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.rows.rotor_estimate import (
    _rotor_modes,
    _share_of_motion,
    estimate_as_measured,
    estimate_rotors,
)
from aerial_gym.sim2real.predict.rows.spectra import delay_by_quarter_period, torque_gain_uncertainty
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, make_predictor
from tests.unit.sim2real.predict.test_scene import G, hover

NOISE, RATE, SECONDS, BAND = 3.0, 200.0, 60.0, 10.0
PITCH = np.array([1.0, -1.0, -1.0, 1.0])  # Rotors that turn the vehicle about y together: the third of their modes

Array = np.ndarray


def pitch_flight(motion: float, seed: int = 0, **more: object) -> tuple[Flight, Array]:
    """Return a hover whose rotors pitch it by slow random motion (rms, rad/s), logged with noise, and their true speeds."""
    rng, rows = np.random.default_rng(seed), round(SECONDS * RATE)
    still = hover("hover", 5.0)
    slow = lowpass(rng.standard_normal(rows), RATE, 2.0)
    true = still.rotor_speed[0] + (motion * slow / slow.std())[:, None] * PITCH
    zeros = np.zeros((rows, 3))
    tiled = {name: np.tile(getattr(still, name)[0], (rows, 1)) for name in ("position", "attitude", "specific_force")}
    logged = {"rotor_speed": true + NOISE * rng.standard_normal(true.shape), "lin_vel": zeros, "ang_vel": zeros}
    result = replace(still, rate=RATE, time=np.arange(rows) / RATE, **(tiled | logged | more))
    return result, true


def pitch_motion(speed: Array) -> Array:
    """Return the pitch that rotor speeds (T, R) cause in the band, without mean and ends."""
    part = lowpass(speed @ PITCH / 2.0, RATE, BAND)[200:-200]
    return part - part.mean()


def slope(true: Array, results: Array) -> float:
    """Return the slope of what is true over what is found: below 1 for what is found with noise."""
    a, b = pitch_motion(true), pitch_motion(results)
    return float(a @ b / (b @ b))


@pytest.mark.parametrize("motion", [0.3, 0.6, 3.0])
def test_what_is_true_follows_what_is_expected_one_to_one(motion: float) -> None:
    """Measured speeds have S / (S + N) for a slope, N the noise in the band of 10 of 100 Hz; expected ones have 1. In
    the mean over eight flights, and each flight within two deviations of what it says is unsure."""
    measured, expected, away = [], [], []
    for seed in range(8):
        flight, true = pitch_flight(motion, seed)
        result = estimate_rotors(ROBOT, [flight], BAND)[0]
        assert flight.rotor_speed is not None
        measured.append(slope(true, flight.rotor_speed))
        expected.append(slope(true, result.speed))
        unsure, missed = pitch_motion(result.unsure[2]), pitch_motion(true) - pitch_motion(result.speed)
        away.append(float(unsure @ missed / (unsure @ unsure)))
    strength, noise = 4.0 * motion**2, NOISE**2 * BAND / (RATE / 2.0)
    assert np.mean(measured) == pytest.approx(strength / (strength + noise), rel=0.1)
    assert np.mean(expected) == pytest.approx(1.0, abs=0.08)
    assert np.abs(away).max() < 2.0


def test_of_a_still_hover_little_scatter_stays() -> None:
    flight, _ = pitch_flight(0.0)
    result = estimate_rotors(ROBOT, [flight], BAND)[0]
    assert (pitch_motion(result.speed) ** 2).mean() < 0.02 * (pitch_motion(flight.rotor_speed) ** 2).mean()
    np.testing.assert_allclose(result.speed.mean(axis=0), flight.rotor_speed.mean(axis=0), rtol=1e-6)


def test_where_a_vehicle_moves_speeds_stay_as_they_were_measured() -> None:
    """In the band: 60 rad/s beside noise of 1.3 rad/s; and the share is then sure."""
    flight, _ = pitch_flight(30.0)
    result = estimate_rotors(ROBOT, [flight], BAND)[0]
    assert flight.rotor_speed is not None
    changed = pitch_motion(result.speed) - pitch_motion(flight.rotor_speed)
    assert np.sqrt((changed**2).mean()) < NOISE * np.sqrt(BAND / (RATE / 2.0))
    unsure = np.stack([pitch_motion(mode) for mode in result.unsure])
    assert np.sqrt((unsure**2).mean(axis=1)).max() < 0.01 * 60.0


def led_by_commands(flight: Flight, true: Array, tau: float) -> Flight:
    """Return the flight with the commands that lead to its true speeds by a lag [s]."""
    kept = np.exp(-1.0 / RATE / tau)
    command = (true[1:] - kept * true[:-1]) / (1.0 - kept)
    return replace(flight, rotor_command=np.concatenate((command, command[-1:])))


def test_what_commands_lead_to_is_expected_where_noise_is_all_that_differs() -> None:
    flight, true = pitch_flight(0.3)
    led = led_by_commands(flight, true, ROBOT.rotor.time_constant_up)
    result = estimate_rotors(ROBOT, [led], BAND)[0]
    assert led.rotor_speed is not None
    missed = (pitch_motion(result.speed) - pitch_motion(true)).std()
    assert missed < 0.3 * (pitch_motion(led.rotor_speed) - pitch_motion(true)).std()


def test_where_motion_is_more_than_noise_a_lag_that_is_wrong_changes_nothing() -> None:
    """Commands of a vehicle that moves are not asked: a lag that is off by 10 % would be 1.7 rad/s, as large as noise."""
    flight, true = pitch_flight(30.0)
    led = led_by_commands(flight, true, 0.9 * ROBOT.rotor.time_constant_up)
    one, other = (estimate_rotors(ROBOT, [index], BAND)[0] for index in (flight, led))
    assert (pitch_motion(one.speed) - pitch_motion(other.speed)).std() < 0.1


def test_a_log_that_is_too_slow_or_without_noise_stays_as_it_is() -> None:
    slow = hover("slow", 5.0, rate=20.0)
    for flight, band in ((slow, 4.0), (pitch_flight(1.0)[0], 80.0), (hover("exact", 5.0), BAND)):
        result, measured = estimate_rotors(ROBOT, [flight], band)[0], estimate_as_measured(flight)
        np.testing.assert_array_equal(result.speed, measured.speed)
        assert not result.unsure.any()


def test_a_log_of_commands_alone_has_nothing_to_expect() -> None:
    flight = hover("told", 5.0, rotor_speed=None, rotor_command=np.full((400, 4), 1000.0))
    assert estimate_rotors(ROBOT, [flight], BAND) == [None]


def test_modes_are_those_of_thrust_roll_pitch_and_yaw_and_what_makes_none() -> None:
    angle = np.pi / 3.0 * np.arange(6)
    made = np.zeros((6, 6))
    made[2:] = np.ones(6), np.sin(angle), -np.cos(angle), 0.01 * (-1.0) ** np.arange(6)
    modes = _rotor_modes(made)
    np.testing.assert_allclose(modes.T @ modes, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(np.abs(np.diag(made[2:] @ modes[:, :4])), np.linalg.norm(made[2:], axis=1), rtol=1e-12)
    np.testing.assert_allclose(made @ modes[:, 4:], 0.0, atol=1e-12)


def test_the_share_of_motion_is_as_sure_as_it_says() -> None:
    """Densities of 1 + S with S = 0.2, 1, 10 in 20 lines, of 10 segments: the mean share lies within two mean deviations."""
    rng, lines, segments = np.random.default_rng(0), 20, 10
    for motion in (0.2, 1.0, 10.0):
        away = []
        for _ in range(200):
            density = (1.0 + motion) * rng.gamma(segments, 1.0 / segments, lines)
            share, spread = _share_of_motion(density, float(segments), 0.0)
            away.append((share.mean() - motion / (1.0 + motion)) / spread.mean())
        assert np.mean(np.abs(away) < 2.0) > 0.9


def test_rotors_that_moved_more_than_expected_are_a_deviation_like_any_other() -> None:
    """One standard deviation in the mode of roll or yaw adds what is unsure of it to that torque, half of one half."""
    flight, _ = pitch_flight(0.6)
    predictor = make_predictor([flight])
    names = Tolerances().names(4)
    base = predictor.predict(ModelParams())[0]
    place = {"rotor_motion_2": 3, "rotor_motion_4": 5}
    for name, channel in place.items():
        unit = np.eye(len(names))[names.index(name)]
        one, half = (predictor.predict(ModelParams(deviation=size * unit))[0] - base for size in (1.0, 0.5))
        assert np.abs(one[:, channel]).max() > 0.0
        np.testing.assert_allclose(half[:, channel], 0.5 * one[:, channel], atol=0.01 * np.abs(one[:, channel]).max())


LOOP_BAND, LOOP_SECONDS, YAW = 10.0, 40.0, 5
RATIO, FACTOR, INERTIA, LAG = 0.015, 1.2e-6, 4e-3, 0.04
SPIN = np.array([1.0, -1.0, 1.0, -1.0])


def hold_heading(
    seed: int = 0, *, noise: float = 0.02, asked: float = 0.0, rate: float = 200.0, told: bool = True
) -> Flight:
    """Return a hover whose heading rate is held by a loop of 12 1/s that reads a noisy gyro [rad/s], logged. ``asked``
    is the rms of a turn of 1 Hz that it is told to make [rad/s]; ``told``: commands are logged, not exact speeds."""
    rng, fine = np.random.default_rng(seed), 5
    rows, step, drift = round(LOOP_SECONDS * rate), 1.0 / (rate * fine), 0.0
    base = np.sqrt(ROBOT.body.mass * G / 4.0 / FACTOR)
    per_speed = 4.0 * RATIO * 2.0 * FACTOR * base / INERTIA
    read, command, speed = np.zeros((rows, 3)), np.zeros((rows, 4)), np.zeros((rows, 4))
    read[:, :2] = 0.003 * rng.standard_normal((rows, 2))
    turn = moved = 0.0
    for k in range(rows):
        read[k, 2] = turn + noise * rng.standard_normal()
        goal = np.sqrt(2.0) * asked * np.sin(2.0 * np.pi * k / rate)
        wish = 12.0 * (goal - read[k, 2]) / per_speed
        command[k], speed[k] = base - wish * SPIN, base - moved * SPIN
        for _ in range(fine):
            drift += -step * 2.0 * drift + 0.02 * np.sqrt(step) * rng.standard_normal()
            moved += step * (wish - moved) / LAG
            turn += step * (per_speed * moved + drift)
    still, zeros = hover("hover", 5.0), np.zeros((rows, 3))
    tiled = {name: np.tile(getattr(still, name)[0], (rows, 1)) for name in ("position", "attitude", "specific_force")}
    logged = {"rotor_command": command, "rotor_speed": None} if told else {"rotor_speed": speed}
    time = np.arange(rows) / rate
    return replace(still, rate=rate, time=time, lin_vel=zeros, ang_vel=read, **tiled, **logged)


def torque_std(flight: Flight) -> Array:
    vehicle = vehicle_from_config(ROBOT, num_envs=1, dtype=torch.float64)
    return torque_gain_uncertainty(
        flight, vehicle, make_predictor([flight]).predict(ModelParams())[0][:, 3:6], LOOP_BAND
    )


def seems_larger(flight: Flight) -> tuple[float, float]:
    """Return the relative excess of the measured yaw over the predicted one, in phase and a quarter period late.

    It is the regression slope of their difference.
    """
    predictor = make_predictor([flight])
    tables = predictor.predict(ModelParams()), predictor.measured
    expected, measured = (rows[0][:, YAW] - rows[0][:, YAW].mean() for rows in tables)
    late = delay_by_quarter_period(expected[:, None])[:, 0]
    at_once, later = ((measured - expected) @ wave / (wave @ wave) for wave in (expected, late))
    return float(at_once), float(later)


def test_a_quarter_period_late_is_minus_the_cosine_of_a_sine() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi * 7.0, 200, endpoint=False)[:, None]
    np.testing.assert_allclose(delay_by_quarter_period(np.sin(angle)), -np.cos(angle), atol=1e-12)


@pytest.mark.parametrize("told", [True, False])
def test_what_a_hover_seems_to_turn_more_lies_below_the_bound(told: bool) -> None:
    """The bound is root 3 of a standard deviation; what is seen is a third of it at least, with the same sign each time."""
    for seed in range(3):
        flight = hold_heading(seed, told=told)
        bound = np.sqrt(3.0) * torque_std(flight)[2]
        for result in seems_larger(flight):
            assert 0.15 < result < bound < 3.0 * result


def test_it_is_next_to_nothing_where_the_vehicle_turns() -> None:
    flight = hold_heading(asked=1.0)
    assert max(map(abs, seems_larger(flight))) < 0.01
    assert 0.0 < torque_std(flight)[2] < 0.01


def test_without_noise_there_is_none() -> None:
    assert torque_std(hold_heading(noise=0.0))[2] < 0.01 * torque_std(hold_heading())[2]


def test_a_slow_log_cannot_tell() -> None:
    assert not torque_std(hold_heading(rate=40.0)).any()


def test_a_deviation_adds_a_share_of_the_torque() -> None:
    flight = hold_heading()
    predictor, share = make_predictor([flight]), torque_std(flight)[2]
    names = Tolerances().names(4)
    base = predictor.predict(ModelParams())[0]
    moved = base[:, YAW] - base[:, YAW].mean()
    added = {"answered_noise_z": moved, "answered_noise_late_z": delay_by_quarter_period(moved[:, None])[:, 0]}
    for (name, wave), effects in product(added.items(), ({}, {"torque_ratio": np.array([1.5])})):
        params, deviation = ModelParams(effects=effects), 1.5 * np.eye(len(names))[names.index(name)]
        changed = predictor.predict(replace(params, deviation=deviation))[0] - predictor.predict(params)[0]
        np.testing.assert_allclose(changed[:, YAW], 1.5 * share * wave, atol=1e-9)
        np.testing.assert_array_equal(np.delete(changed, YAW, axis=1), 0.0)
