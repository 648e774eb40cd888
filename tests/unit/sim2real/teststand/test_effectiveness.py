"""Effectiveness and exponent of thrust with noise of the inputs, and with a drag along the thrust."""

import numpy as np
import pytest

from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.teststand.command_curve import fit_thrust_power
from aerial_gym.sim2real.teststand.effectiveness import _least_squares, _sizes_of_reverse_regression


@pytest.mark.parametrize("noise_in", [0.0, 0.5])
@pytest.mark.parametrize("noise_out", [0.0, 0.5])
def test_both_regressions_enclose_the_true_size(noise_in: float, noise_out: float) -> None:
    """Of unit variance and slope 2, they have the slopes ``2 / (1 + n²)`` and ``(4 + m²) / 2`` with noises n and m."""
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((100_000, 4))
    motion = 2.0 * inputs + noise_out * rng.standard_normal(inputs.shape)
    table = np.concatenate(
        (inputs + noise_in * rng.standard_normal(inputs.shape), rng.standard_normal((100_000, 2))), axis=1
    )
    direct = np.diag(_least_squares(table, motion)[:4])
    np.testing.assert_allclose(direct, 2.0 / (1.0 + noise_in**2), rtol=0.02)
    reverse = _sizes_of_reverse_regression(table, motion, direct)
    np.testing.assert_allclose(reverse, (4.0 + noise_out**2) / 2.0, rtol=0.02)


def test_a_motion_of_the_other_sign_has_no_reverse_size() -> None:
    table = np.random.default_rng(1).standard_normal((1000, 4))
    assert np.isinf(_sizes_of_reverse_regression(table, -table, np.ones(4))).all()


@pytest.mark.parametrize("exponent", [1.8, 2.0, 2.2])
def test_drag_along_the_thrust_does_not_change_its_exponent(exponent: float) -> None:
    """The specific force is ``c sum w^p - d v``; v follows the thrust late, as climbs do."""
    rate, span = 200.0, 40.0
    time = np.arange(round(rate * span)) / rate
    speed = 900.0 + 60.0 * np.sin(2.0 * np.pi * 0.9 * time) + 40.0 * np.sin(2.0 * np.pi * 1.7 * time + 1.0)
    thrust = 9.81 * (speed / 900.0) ** exponent
    climb = np.cumsum(thrust - thrust.mean()) / rate
    force = np.zeros((time.size, 3))
    force[:, 2] = thrust - 1.5 * climb
    log = FlightLog(
        path="a.csv", time=time, attitude=np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1)), specific_force=force,
        lin_vel=np.stack((0.0 * climb, 0.0 * climb, climb), axis=1), rotor_command=np.tile(speed[:, None], (1, 4)),
    )  # fmt: skip
    fit = fit_thrust_power([log])
    assert fit is not None
    assert fit[0].value == pytest.approx(exponent, abs=0.02)  # the least lag of the fit is 1 ms
