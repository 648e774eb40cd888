"""A minimum within bounds, against scipy and the conditions that it must meet."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from aerial_gym.sim2real.identify.least_squares import box_minimum
from aerial_gym.sim2real.identify.least_squares.box_minimum import minimise_in_bounds


def problem(seed: int, size: int = 30) -> tuple[NDArray[np.float64], ...]:
    """Return sums of strongly correlated columns of different sizes, and bounds of which many are met; some are none, or 0."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(2 * size, size)) * 10.0 ** rng.uniform(-2.0, 2.0, size)
    columns += 0.9 * columns[:, :1]
    high = np.where(rng.random(size) < 0.2, np.inf, rng.uniform(0.0, 1.0, size))
    low = np.where(rng.random(size) < 0.2, 0.0, -high)
    return columns.T @ columns + np.eye(size), columns.T @ rng.normal(scale=3.0, size=2 * size), low, high


@pytest.mark.parametrize("rounds", [box_minimum.MOST_ROUNDS, 0])
def test_the_minimum_is_that_of_another_method(rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(box_minimum, "MOST_ROUNDS", rounds)
    for seed in range(20):
        a, b, low, high = problem(seed)
        root = np.linalg.cholesky(a).T
        bounds = np.minimum(low, -1e-12), np.maximum(high, 1e-12)
        expected = lsq_linear(root, np.linalg.solve(root.T, b), bounds=bounds, method="trf", tol=1e-14, max_iter=500).x
        np.testing.assert_allclose(minimise_in_bounds(a, b, low, high), expected, rtol=0.0, atol=2e-6)


def test_nothing_pulls_further_inward(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the minimum no free parameter is pulled, and one at a bound only beyond it; scipy is hardly ever asked."""
    asked: list[object] = []
    monkeypatch.setattr(
        box_minimum, "lsq_linear", lambda *args, **options: asked.append(args) or lsq_linear(*args, **options)
    )
    met = 0
    for seed in range(200):
        a, b, low, high = problem(seed)
        result = minimise_in_bounds(a, b, low, high)
        pull = (b - a @ result) / np.sqrt(np.diag(a))
        assert np.all(result >= low - 1e-9)
        assert np.all(result <= high + 1e-9)
        at_low, at_high = result <= low + 1e-9, result >= high - 1e-9
        assert np.all(np.abs(pull[~at_low & ~at_high]) < 1e-8)
        assert np.all(pull[at_low & ~at_high] < 1e-8)
        assert np.all(pull[at_high & ~at_low] > -1e-8)
        met += int((at_low | at_high).sum())
    assert met > 1000
    assert len(asked) < 5


def test_no_minimum_of_numbers_that_are_none() -> None:
    a, b, low, high = problem(0)
    assert np.isnan(minimise_in_bounds(a, np.where(np.arange(b.size) == 3, np.nan, b), low, high)).all()
