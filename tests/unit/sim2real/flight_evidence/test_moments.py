"""Sums of a flight against dense linear algebra, and the noise that they assume."""

import numpy as np
import pytest

from aerial_gym.sim2real.flight_evidence.moments import FlightSums, _noise_weights, with_common_tolerances
from aerial_gym.sim2real.identify.least_squares.derivative_sums import drop_zero_channels, moments_by_channel
from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights


def test_tolerances_of_one_flight_act_as_further_noise() -> None:
    """The covariance is ``I + E E^T``, with the excess columns E: ``own^2 - common^2`` per declared variance."""
    rng = np.random.default_rng(0)
    effects, tolerances, residual = rng.normal(size=(40, 3)), rng.normal(size=(40, 4)), rng.normal(size=40)
    own, common = np.array([2.0, 0.5, 0.0, 1.0]), np.array([0.5, 0.5, 0.0, 0.0])
    whole = np.hstack((effects, tolerances * own))
    given = FlightSums(product=whole.T @ whole, gradient=whole.T @ residual, square=residual @ residual, rows=40)
    sums = with_common_tolerances(given, own, common)

    excess = tolerances * np.sqrt(own**2 - common**2)
    inverse = np.linalg.inv(np.eye(40) + excess @ excess.T)
    kept = np.hstack((effects, tolerances[:, :2] * common[:2]))
    np.testing.assert_allclose(sums.product, kept.T @ inverse @ kept, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(sums.gradient, kept.T @ inverse @ residual, rtol=1e-10, atol=1e-10)
    assert sums.square == pytest.approx(residual @ inverse @ residual, rel=1e-10)


def test_a_fit_of_many_columns_does_not_lower_the_noise() -> None:
    """60 columns take as many degrees of freedom of 400, but weights are those of the noise itself on average."""
    rng, ratios = np.random.default_rng(1), []
    for _ in range(30):
        effects = drop_zero_channels([rng.normal(size=(200, 2, 60))])
        tolerances, residual = rng.normal(size=(200, 2, 1)).astype(np.float32), 2.0 * rng.normal(size=(200, 2))
        moments = moments_by_channel([residual], [[*effects, tolerances]])
        bounds = np.full(60, -1e6), np.full(60, 1e6)
        weight = _noise_weights(residual, effects, tolerances, moments, bounds)
        ratios.append(np.mean(weight / inverse_variance_weights([residual]).weight))
    assert abs(np.mean(ratios) - 1.0) < 3.0 * np.std(ratios) / np.sqrt(30) + 0.02  # the last share is of the estimate


def test_sums_of_flights_add() -> None:
    rng = np.random.default_rng(2)
    parts = [(rng.normal(size=(rows, 5)), rng.normal(size=rows)) for rows in (7, 9)]
    one, other, both = (
        FlightSums(product=j.T @ j, gradient=j.T @ r, square=r @ r, rows=len(r))
        for j, r in (*parts, tuple(np.concatenate(part) for part in zip(*parts, strict=True)))
    )
    total = one + other
    np.testing.assert_allclose(total.product, both.product)
    np.testing.assert_allclose(total.gradient, both.gradient)
    assert total.rows == both.rows
