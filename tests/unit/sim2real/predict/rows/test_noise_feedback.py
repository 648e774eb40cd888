"""What an autopilot's answer to noise of the gyro does to a comparison of torques, on a loop integrated here."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from aerial_gym.physics import vehicle_from_config
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.rows.noise_feedback import torque_gain_uncertainty
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, make_predictor
from tests.unit.sim2real.predict.test_scene import G, hover

BAND, SECONDS, YAW = 10.0, 40.0, 5
RATIO, FACTOR, INERTIA, LAG = 0.015, 1.2e-6, 4e-3, 0.04
SPIN = np.array([1.0, -1.0, 1.0, -1.0])

Array = np.ndarray


def hold_heading(
    seed: int = 0, *, noise: float = 0.02, asked: float = 0.0, rate: float = 200.0, told: bool = True
) -> Flight:
    """Return a hover whose heading rate is held by a loop of 12 1/s that reads a noisy gyro [rad/s], logged. ``asked``
    is the rms of a turn of 1 Hz that it is told to make [rad/s]; ``told``: commands are logged, not exact speeds."""
    rng, fine = np.random.default_rng(seed), 5
    rows, step, drift = round(SECONDS * rate), 1.0 / (rate * fine), 0.0
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
    return torque_gain_uncertainty(flight, vehicle, make_predictor([flight]).predict(ModelParams())[0][:, 3:6], BAND)


def seems_larger(flight: Flight) -> float:
    """Return the relative excess of the measured yaw over the predicted one: their regression slope less 1."""
    predictor = make_predictor([flight])
    tables = predictor.predict(ModelParams()), predictor.measured
    expected, measured = (rows[0][:, YAW] - rows[0][:, YAW].mean() for rows in tables)
    return float(measured @ expected / (expected @ expected)) - 1.0


@pytest.mark.parametrize("told", [True, False])
def test_what_a_hover_seems_to_turn_more_lies_below_the_bound(told: bool) -> None:
    """The bound is root 3 of a standard deviation; what is seen is a third of it at least, with the same sign each time."""
    for seed in range(3):
        flight = hold_heading(seed, told=told)
        result, bound = seems_larger(flight), np.sqrt(3.0) * torque_std(flight)[2]
        assert 0.15 < result < bound < 3.0 * result


def test_it_is_next_to_nothing_where_the_vehicle_turns() -> None:
    flight = hold_heading(asked=1.0)
    assert abs(seems_larger(flight)) < 0.01
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
    deviation = 1.5 * np.eye(len(names))[names.index("answered_noise_z")]
    for effects in ({}, {"torque_ratio": np.array([1.5])}):
        params = ModelParams(effects=effects)
        changed = predictor.predict(replace(params, deviation=deviation))[0] - predictor.predict(params)[0]
        np.testing.assert_allclose(changed[:, YAW], 1.5 * share * (base[:, YAW] - base[:, YAW].mean()), atol=1e-9)
        np.testing.assert_array_equal(np.delete(changed, YAW, axis=1), 0.0)
