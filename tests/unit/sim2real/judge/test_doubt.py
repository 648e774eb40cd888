"""The density of test flights given training, against the normal distribution that it is."""

import numpy as np
from scipy.stats import multivariate_normal

from aerial_gym.sim2real.judge.doubt import ResidualSums

ROWS, CHANNELS, PARAMETERS = 12, 2, 3


def make_remainder(jacobian: np.ndarray, residual: np.ndarray, precision: np.ndarray) -> ResidualSums:
    return ResidualSums(
        square=(residual**2).sum(axis=0),
        gradient=np.einsum("rck,rc->ck", jacobian, residual),
        product=np.einsum("rck,rcl->ckl", jacobian, jacobian),
        precision=precision,
    )


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
