"""Residuals of test flights: whether they are noise, how probable training makes them, and what remains above noise."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aerial_gym.sim2real.identify.least_squares.gauss_newton import ModelFit
from aerial_gym.sim2real.identify.least_squares.moments import block_moments
from aerial_gym.sim2real.judge.doubt import ResidualSums
from aerial_gym.sim2real.judge.residual_excess import is_material_excess, model_with_best_deviations
from aerial_gym.sim2real.judge.whiteness import (
    WHITE,
    octave_ranges,
    power_by_octave,
    spectral_lines,
    whiteness_of_channels,
)
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams


def linear_fit(residual: np.ndarray, jacobian: np.ndarray, *, num_effect_params: int) -> ModelFit:
    """Return a fit of one flight of 10 s, its effects' parameters in front."""
    rows, width = residual.shape[0], jacobian.shape[2]
    return ModelFit(
        effects=("rotor_drag",), params=ModelParams(effects={"rotor_drag": np.full(3, 0.2)}),
        moments=block_moments([np.linspace(0.0, 10.0, rows)], [residual], [jacobian], length=1.0),
        low=np.full(width, -9.0), high=np.full(width, 9.0), num_effect_params=num_effect_params,
    )  # fmt: skip


def test_the_model_that_is_judged_has_the_parameters_of_the_robot_file() -> None:
    """Single steps ask for another drag than the file holds, whose drag came from rollouts: the effects stay as they are
    written, and the deviations solve ``(J^T W J + 1) d = J^T W r`` beside them."""
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((500, 2, 7))
    residual = jacobian @ np.array([0.5, -0.3, 0.2, 1.0, 0.0, -1.0, 2.0]) + 0.1 * rng.standard_normal((500, 2))
    weight, written = np.array([2.0, 0.5]), ModelParams(effects={"rotor_drag": np.array([0.21, 0.2, 0.19])})
    result = model_with_best_deviations(written, linear_fit(residual, jacobian, num_effect_params=3), weight)
    assert result.effects is written.effects
    root = np.sqrt(weight)[None, :, None]
    columns, values = (jacobian[:, :, 3:] * root).reshape(-1, 4), (residual * root[:, :, 0]).reshape(-1)
    expected = np.linalg.solve(columns.T @ columns + np.eye(4), columns.T @ values)
    np.testing.assert_allclose(result.deviation, expected, rtol=1e-10)


def test_what_remains_is_material_above_noise_and_tolerances() -> None:
    floor, tolerated = np.array([0.02, 0.02, 0.02]), np.array([0.02, 0.02, 0.2])
    rms = np.array([0.024, 0.06, 0.06])  # near the floor; above both; hidden by the tolerances
    assert is_material_excess(rms, floor, tolerated).tolist() == [False, True, False]
    assert is_material_excess(rms, None, tolerated).tolist() == [False, False, False]


ROWS, CHANNELS, PARAMETERS = 12, 2, 3


def make_remainder(jacobian: np.ndarray, residual: np.ndarray, precision: np.ndarray) -> ResidualSums:
    return ResidualSums(
        square=(residual**2).sum(axis=0), gradient=np.einsum("rck,rc->ck", jacobian, residual),
        product=np.einsum("rck,rcl->ckl", jacobian, jacobian), precision=precision,
    )  # fmt: skip


def test_the_density_is_that_of_a_normal_residual_with_unknown_parameters() -> None:
    """But for what noise alone has: ``r ~ N(0, 1/w + J A^-1 J^T)``, written out."""
    rng = np.random.default_rng(4)
    jacobian, residual = rng.normal(size=(ROWS, CHANNELS, PARAMETERS)), rng.normal(size=(ROWS, CHANNELS))
    root = rng.normal(size=(PARAMETERS, PARAMETERS))
    precision, weight = root @ root.T + np.eye(PARAMETERS), np.array([3.0, 0.4])
    noise = np.diag(np.tile(1.0 / weight, ROWS))
    flat, rows = residual.ravel(), jacobian.reshape(-1, PARAMETERS)
    whole = multivariate_normal(cov=noise + rows @ np.linalg.inv(precision) @ rows.T).logpdf(flat)
    alone = multivariate_normal(cov=noise).logpdf(np.zeros(flat.size))
    result = make_remainder(jacobian, residual, precision).log_density(weight)
    np.testing.assert_allclose(result, whole - alone, rtol=1e-10)


def test_what_training_knows_test_flights_cannot_move() -> None:
    rng = np.random.default_rng(5)
    jacobian, weight = rng.normal(size=(200, CHANNELS, PARAMETERS)), np.array([4.0, 4.0])
    residual = jacobian @ np.array([0.5, -1.0, 0.7]) + 0.5 * rng.normal(size=(200, CHANNELS))
    loose, tight = (make_remainder(jacobian, residual, k * np.eye(PARAMETERS)) for k in (1.0, 1e6))
    assert loose.log_density(weight) - tight.log_density(weight) > 100.0
    np.testing.assert_allclose(loose.joint_step(weight), [0.5, -1.0, 0.7], atol=0.1)
    assert np.abs(tight.joint_step(weight)).max() < 0.01


RATE, BAND = 30.0, 10.0
FORCE, TURN = Channel(kind="specific_force", axis="x"), Channel(kind="angular_acceleration", axis="x")


def low_passed(values: np.ndarray, *, derivative: bool = False) -> np.ndarray:
    """Return noise sampled at ten times the band, low-passed and decimated to three times the band as in a comparison."""
    return lowpass(values, 100.0, BAND, derivative=derivative)[::3][10:-10]


def test_noise_is_called_noise_as_often_as_stated() -> None:
    """400 residuals of two flights: p is uniform, also of a differentiated sensor."""
    rng = np.random.default_rng(0)
    result = []
    for _ in range(200):
        noise = [rng.standard_normal((1000, 1)) for _ in range(2)]
        both = [np.hstack((low_passed(n), low_passed(n, derivative=True))) for n in noise]
        times = [0.03 * np.arange(len(rows)) for rows in both]
        result += [w.probability for w in whiteness_of_channels(times, both, (FORCE, TURN), BAND)]
    for share in (0.05, 0.2, 0.5):
        scatter = 4.0 * np.sqrt(share * (1 - share) / 400) + 0.02
        assert np.mean(np.array(result) < share) == pytest.approx(share, abs=scatter)


@pytest.mark.parametrize("kind", ["line", "drift"])
def test_what_is_no_noise_is_told_and_where_it_lies(kind: str) -> None:
    rng, time = np.random.default_rng(1), 0.03 * np.arange(400)
    own = np.sin(2.0 * np.pi * 7.0 * time) if kind == "line" else np.sin(2.0 * np.pi * 0.3 * time)
    values = rng.standard_normal((400, 1)) + own[:, None]
    (result,) = whiteness_of_channels([time], [values], (FORCE,), BAND)
    assert result.probability < WHITE
    assert not result.white
    assert int(np.argmax(result.octaves)) == (3 if kind == "line" else 0)


def test_a_sine_lies_in_its_octave_with_its_power_and_gaps_split_flights() -> None:
    """``rows / 2`` of a sine of 4 Hz, undone for the gain of the low-pass there."""
    time = np.arange(300) / RATE
    frequency, power = spectral_lines([time], [np.sin(2.0 * np.pi * 4.0 * time)[:, None]], BAND)
    octaves = power_by_octave(frequency, power, BAND)[:, 0]
    gain = 1.0 / (1.0 + 0.4**8)
    np.testing.assert_allclose(octaves, [0.0, 0.0, 300 / 4 / gain**2, 0.0], atol=1e-9)
    assert octave_ranges(BAND)[2] == "2.5 to 5 Hz"
    jump = np.where(time < 5.0, time, time + 3.0)
    split, _ = spectral_lines([jump], [np.ones((300, 1))], BAND)
    assert split.min() == pytest.approx(RATE / 150)
