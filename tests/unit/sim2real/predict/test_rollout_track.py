"""Rollouts along a whole flight against the closed form of a wrong mass in hover."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.rollout import FIRST_WINDOW_S, rows_per_step
from aerial_gym.sim2real.predict.rollout_track import find_consecutive_windows, rollout_along_flight
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.predict.test_scene import RATE, G, hover

HEAVY = replace(ROBOT, body=replace(ROBOT.body, mass=1.1 * ROBOT.body.mass))
FALL = G * (1.0 / 1.1 - 1.0)  # The log's thrust carries the true weight


def test_windows_start_anew_after_their_length_and_after_excluded_rows() -> None:
    excluded = np.array([1, 0, 0, 0, 0, 0, 1, 1, 0, 0], dtype=bool)
    assert find_consecutive_windows(excluded, 3).tolist() == [-1, 1, 1, 1, 4, 4, -1, -1, 8, 8]


@pytest.mark.parametrize("restart_s", [0.1, 0.5, 20.0])
def test_a_vehicle_that_is_too_heavy_falls_by_half_a_t_squared_from_each_restart(restart_s: float) -> None:
    flight = hover("log", 5.0)
    track = rollout_along_flight(HEAVY, ModelParams(), flight, restart_s)
    flies = track.start >= 0
    assert np.argmax(flies) == round(FIRST_WINDOW_S * RATE)
    assert flies[np.argmax(flies) :].all()
    assert rows_per_step(RATE) == 1
    since = (np.arange(flight.num_rows) - track.start)[flies] / RATE
    assert since.max() == pytest.approx(min(restart_s, 4.0 - FIRST_WINDOW_S) - 1.0 / RATE)
    np.testing.assert_allclose(track.position[flies, 2], 5.0 + 0.5 * FALL * since**2, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(track.errors["position"][flies], 0.5 * -FALL * since**2, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(track.errors["velocity"][flies], -FALL * since, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(track.errors["attitude"][flies], 0.0, atol=1e-9)
    assert np.isnan(track.position[~flies]).all()


def test_rows_on_the_ground_have_no_rollout_and_the_next_one_starts_behind_them() -> None:
    on_ground = np.zeros(400, dtype=bool)
    on_ground[150:170] = True
    track = rollout_along_flight(HEAVY, ModelParams(), hover("log", 5.0, on_ground=on_ground), 20.0)
    assert (track.start[150:170] == -1).all()
    assert np.isnan(track.errors["position"][150:170]).all()
    assert (track.start[170:] == 170).all()
    assert track.position[170, 2] == 5.0


def test_a_log_without_torques_gives_the_attitude_and_one_without_position_no_position_error() -> None:
    tilted = np.tile([0.0, 0.0, 0.0, 1.0], (400, 1))
    tilted[:, 0], tilted[:, 3] = np.sin(0.5e-3 * np.arange(400)), np.cos(0.5e-3 * np.arange(400))
    track = rollout_along_flight(HEAVY, ModelParams(), hover("log", 5.0, torques=False, attitude=tilted), 1.0)
    assert track.errors.keys() == {"position", "velocity"}
    np.testing.assert_allclose(track.attitude[50:], tilted[50:], atol=2e-3)
    blind = rollout_along_flight(HEAVY, ModelParams(), hover("log", 5.0, position=None), 1.0)
    assert blind.errors.keys() == {"velocity", "attitude"}


def test_the_same_flight_is_predicted_bit_for_bit_again() -> None:
    one, two = (rollout_along_flight(HEAVY, ModelParams(), hover("log", 5.0), 0.3) for _ in range(2))
    np.testing.assert_array_equal(one.position, two.position)
    np.testing.assert_array_equal(one.errors["velocity"], two.errors["velocity"])
