"""White noise of sensors beside motion, against the deviation with which it was drawn."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.preflight.noise import sensor_noise


def test_noise_is_that_of_the_draw_beside_slow_motion() -> None:
    """Motion of 1 Hz is far below the lines of the fit; 20,000 samples scatter by less than 3 %."""
    rng, time = np.random.default_rng(0), np.arange(20_000) / 250.0
    wave = np.sin(2.0 * np.pi * time)[:, None] * (1.0, 0.5, 0.2)
    drawn = {"position": 0.01, "lin_vel": 0.05, "ang_vel": 0.02}
    values = {name: wave + std * rng.standard_normal(wave.shape) for name, std in drawn.items()}
    turn = Rotation.from_rotvec(0.5 * wave) * Rotation.from_rotvec(0.01 * rng.standard_normal(wave.shape))
    log = FlightLog(path="a.csv", time=time, attitude=turn.as_quat(canonical=True), **values)
    assert sensor_noise([log]) == pytest.approx(drawn | {"attitude": 0.01}, rel=0.05)


def test_noise_of_a_stream_that_is_not_logged_is_absent() -> None:
    time = np.arange(5_000) / 250.0
    log = FlightLog(path="a.csv", time=time, attitude=np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1)))
    assert sensor_noise([log]) == {"attitude": 0.0}
