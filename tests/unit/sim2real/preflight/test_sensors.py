"""Sensors against an attitude that is exact, and against one that errs in slow motion alone, as a filtered one does."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.logs.checks.kinematics import SLOW_AND_FAST, gains_of_moving_sensors
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.preflight.constants import Constant
from aerial_gym.sim2real.preflight.sensors import check_sensors

RATE, SPAN_S = 200.0, 60.0


def log_with_rolls(*, scale: float = 1.0, slow_share: float = 1.0, delay: float = 0.0, fast: float = 0.02) -> FlightLog:
    """Return a log of rolls at 0.3 to 3.1 Hz: gyro with a scale, attitude with a share of the slow roll and a delay."""
    time, rng = np.arange(round(SPAN_S * RATE)) / RATE, np.random.default_rng(0)
    frequencies, sizes = 2.0 * np.pi * np.array((0.3, 1.7, 2.3, 3.1)), np.array((0.3, fast, fast, fast))

    def sum_of_waves(wave: object, at: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        return np.sum(amplitudes * wave(np.outer(at, frequencies)), axis=1)  # type: ignore[operator]

    angle = sum_of_waves(np.sin, time - delay, sizes * (slow_share, 1.0, 1.0, 1.0))
    rate = scale * sum_of_waves(np.cos, time, sizes * frequencies)
    noise = 0.01 * rng.standard_normal((time.size, 3))
    angles = np.stack((angle, *np.zeros((2, time.size))), axis=1) + 0.001 * rng.standard_normal((time.size, 3))
    return FlightLog(
        path="a.csv", time=time, attitude=Rotation.from_rotvec(angles).as_quat(),
        ang_vel=np.stack((rate, *np.zeros((2, time.size))), axis=1) + noise,
    )  # fmt: skip


def constant_by_log(log: FlightLog, name: str) -> Constant:
    return next(one for one in check_sensors([log]).constants if one.name == name)


@pytest.mark.parametrize(("scale", "state"), [(1.0, "measured"), (1.03, "contradicted"), (0.97, "contradicted")])
def test_a_scale_of_the_gyro_is_the_same_in_slow_and_fast_motion(scale: float, state: str) -> None:
    constant = constant_by_log(log_with_rolls(scale=scale), "gyro_scale_x")
    assert constant.state == state
    assert constant.estimate is not None
    assert constant.estimate.value == pytest.approx(scale, abs=0.003)
    assert constant.estimate.low <= scale <= constant.estimate.high


@pytest.mark.parametrize("slow_share", [0.9, 1.1])
def test_an_attitude_that_errs_in_slow_motion_shows_no_scale_of_the_gyro(slow_share: float) -> None:
    assert constant_by_log(log_with_rolls(slow_share=slow_share), "gyro_scale_x").state == "assumed"


def test_slow_motion_alone_shows_no_scale_of_the_gyro() -> None:
    log = log_with_rolls(slow_share=1.06, fast=0.003)
    slow, fast = (gains_of_moving_sensors(log, by_axis=True, band=band) for band in SLOW_AND_FAST)
    assert slow[0].gain + slow[0].half_width(0.975) < 0.98
    assert not fast
    assert constant_by_log(log, "gyro_scale_x").state == "assumed"


def test_slow_rotor_columns_show_no_scale_of_the_gyro() -> None:
    log = replace(log_with_rolls(scale=1.03), torques=False)
    assert constant_by_log(log, "gyro_scale_x").reason == "slow_attitude"


def test_a_delay_of_the_attitude_is_that_of_slow_and_fast_motion() -> None:
    constant = constant_by_log(log_with_rolls(delay=0.04), "attitude_latency")
    assert constant.state == "contradicted"
    assert constant.estimate is not None
    assert constant.estimate.value == pytest.approx(0.04, abs=0.001)
    assert constant.tied == ("clock_offset",)
