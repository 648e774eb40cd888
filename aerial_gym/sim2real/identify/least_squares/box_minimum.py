"""Minimum of a quadratic function within bounds. Letters: K parameters."""

import numpy as np
from scipy.optimize import lsq_linear

from aerial_gym.sim2real.arrays import Array

MOST_ROUNDS = 20  # Most iterations of the active set, which usually needs two or three


def minimise_in_bounds(a: Array, b: Array, low: Array, high: Array) -> Array:
    """Return the minimiser of ``x a x / 2 - b x`` (K,) within bounds of either sign; NaN for non-finite input.

    A primal-dual active set gives the exact conditions of the minimum once it repeats; scipy solves the rare case of a
    cycle. Source: Hintermueller, Ito, Kunisch (2002), The primal-dual active set strategy as a semismooth Newton method,
    SIAM Journal on Optimization 13.
    """
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return np.full(b.size, np.nan)
    solution, held = np.linalg.solve(a, b), np.zeros(b.size)
    for _ in range(MOST_ROUNDS):
        target = solution + (b - a @ solution) / np.diag(a)  # free entries stay, bounded ones follow the gradient
        now = 1.0 * (target > high) - 1.0 * (target < low)
        if np.array_equal(now, held):
            return solution
        free, held, solution = now == 0.0, now, np.where(now == 0.0, 0.0, np.clip(target, low, high))
        solution[free] = np.linalg.solve(a[np.ix_(free, free)], b[free] - a[free] @ solution)
    root = np.linalg.cholesky(a).T
    bounds = np.minimum(low, -1e-12), np.maximum(high, 1e-12)
    return lsq_linear(root, np.linalg.solve(root.T, b), bounds=bounds, method="bvls", max_iter=10 * b.size).x
