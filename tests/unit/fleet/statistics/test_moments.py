"""Integrals over Gaussian deviations against dense algebra, and the times of flights."""

import numpy as np
import pytest

from aerial_gym.fleet.statistics.moments import integrate_flights, usable_times


def test_integral_over_the_deviations_of_flights() -> None:
    """Measurements ``y = J x + e`` with ``x ~ N(m, F)`` have the information ``J' (1 + J F J')^-1 J`` about m."""
    rng, variance = np.random.default_rng(0), np.array([0.0, 0.01, 4.0])
    derivatives, measured = rng.standard_normal((5, 3)), rng.standard_normal(5)
    product, gradient = integrate_flights(
        (derivatives.T @ derivatives)[None], (derivatives.T @ measured)[None], variance
    )
    inverse = np.linalg.inv(np.eye(5) + derivatives * variance @ derivatives.T)
    np.testing.assert_allclose(product[0], derivatives.T @ inverse @ derivatives, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(gradient[0], derivatives.T @ inverse @ measured, rtol=1e-4, atol=1e-5)


def test_integral_of_a_singular_flight() -> None:
    """A flight that shows only the sum of two parameters tells nothing of their difference, before and after."""
    product, gradient = integrate_flights(np.full((1, 2, 2), 50.0), np.full((1, 2), 30.0), np.array([0.5, 0.5]))
    expected = 50.0 / (1.0 + 50.0 * 1.0)  # variances of the two add
    np.testing.assert_allclose(product[0], np.full((2, 2), expected), rtol=1e-4)
    np.testing.assert_allclose(gradient[0], np.full(2, 30.0 / 51.0), rtol=1e-4)


@pytest.mark.parametrize("precision", [1e2, 1e5, 1e8])
def test_rounded_moments_stay_positive(precision: float) -> None:
    """Collinear columns stored as float32 give no negative information."""
    rng = np.random.default_rng(1)
    derivatives = rng.standard_normal((200, 30)) @ (np.ones((30, 30)) + 1e-5 * rng.standard_normal((30, 30)))
    rounded = (precision * derivatives.T @ derivatives / 200.0).astype(np.float32).astype(float)[None]
    product, _ = integrate_flights(rounded, np.zeros((1, 30)), np.full(30, 0.01))
    values = np.linalg.eigvalsh(product[0])
    assert values.min() > -1e-6 * values.max()


def test_damaged_moments_are_refused() -> None:
    with pytest.raises(ValueError, match="read the log again"):
        integrate_flights(np.array([[[1.0, 9.0], [9.0, 1.0]]]), np.zeros((1, 2)), np.ones(2))


@pytest.mark.parametrize("times", [[5.0, 5.0, 5.0], [5.0, np.nan, 7.0], [5.0, 3.0, 7.0]])
def test_flight_numbers_replace_unusable_times(times: list[float]) -> None:
    assert usable_times(np.array([5.0, 5.0, 7.0]))[1]
    numbers, is_ordered = usable_times(np.array(times))
    assert (numbers.tolist(), is_ordered) == ([1.0, 2.0, 3.0], False)
