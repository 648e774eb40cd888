"""A process with noise: what whitens it, and its likelihood, against factors of the whole covariance."""

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.stats import multivariate_normal

from aerial_gym.sim2real.judge.random_wind.ornstein_uhlenbeck import (
    WindSeries,
    axis_covariances,
    log_likelihoods,
    whiten_rows,
)

RNG = np.random.default_rng(0)


def make_series(*rows: int) -> WindSeries:
    return WindSeries(wind=[RNG.normal(size=(n, 3)) for n in rows], features={}, step=0.1, bandwidth=8.0)


def test_rows_are_whitened_as_by_the_cholesky_factor() -> None:
    """L^-1 y with C = L L^T, and the diagonal of L: the innovations of a process and their std."""
    covariance = axis_covariances(make_series(40), 0.7, 1.3, np.array([0.1, 0.3, 0.5]))
    values = RNG.normal(size=(3, 40, 2))
    white, variance = whiten_rows(covariance, values)
    for first, columns, result, square in zip(covariance, values, white, variance, strict=True):
        root = cholesky(toeplitz(first), lower=True)
        np.testing.assert_allclose(result, solve_triangular(root, columns, lower=True), rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(np.sqrt(square), np.diag(root), rtol=1e-10)


def test_the_likelihood_is_that_of_differences_from_the_mean() -> None:
    """Restricted likelihood: of any N - 1 contrasts, up to a constant that no parameter enters; flights and axes add up."""
    series = make_series(12, 20)
    processes = [(0.5, 0.8, np.array([0.2, 0.3, 0.4])), (0.9, 2.0, np.array([0.1, 0.2, 0.6]))]
    expected = np.zeros(2)
    for place, process in enumerate(processes):
        for axis, first in enumerate(axis_covariances(series, *process)):
            for wind in series.wind:
                contrasts = np.diff(np.eye(len(wind)), axis=0)
                whole = contrasts @ toeplitz(first[: len(wind)]) @ contrasts.T
                expected[place] += multivariate_normal(cov=whole).logpdf(contrasts @ wind[:, axis])
    result = log_likelihoods(series, processes)
    assert result[1] - result[0] == pytest.approx(expected[1] - expected[0], rel=1e-8)
