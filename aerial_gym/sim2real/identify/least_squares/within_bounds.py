"""The minimum of a quadratic function within bounds.

Letters: K parameters.
"""

import numpy as np
from scipy.optimize import lsq_linear

from aerial_gym.sim2real.arrays import Array

MOST_ROUNDS = 20
"""Of guessing which parameters end at their bounds, which nearly always takes two or three."""


def minimum_within(a: Array, b: Array, low: Array, high: Array) -> Array:
    """Return where ``x a x / 2 - b x`` is least within bounds; NaN where a number is not finite.

    Which parameters end at a bound is guessed from where they would go and what pulls at them, until the guess is true: then
    the conditions for a minimum hold exactly. In the rare case that it goes round in circles scipy takes over.

    Args:
        a: Positive definite, (K, K).
        b: (K,).
        low: Lowest values, (K,), not above 0.
        high: Highest values, (K,), not below 0.

    Source:
        Hintermueller, Ito, Kunisch (2002), The primal-dual active set strategy as a semismooth Newton method, SIAM Journal on
        Optimization 13.
    """
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return np.full(b.size, np.nan)
    found, held = np.linalg.solve(a, b), np.zeros(b.size)
    for _ in range(MOST_ROUNDS):
        target = found + (b - a @ found) / np.diag(a)  # what is free stays, what is held goes where it is pulled
        now = 1.0 * (target > high) - 1.0 * (target < low)
        if np.array_equal(now, held):
            return found
        free, held, found = now == 0.0, now, np.where(now == 0.0, 0.0, np.clip(target, low, high))
        found[free] = np.linalg.solve(a[np.ix_(free, free)], b[free] - a[free] @ found)
    root = np.linalg.cholesky(a).T
    bounds = np.minimum(low, -1e-12), np.maximum(high, 1e-12)
    return lsq_linear(root, np.linalg.solve(root.T, b), bounds=bounds, method="bvls", max_iter=10 * b.size).x
