"""Best steps of a fit in cross-validation, with each label left out once.

Letters: B blocks, C channels, K parameters, N tolerances.
"""

import numpy as np

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.least_squares.gauss_newton import ModelFit, normal_equations, solve_bounded_step


def leave_out_steps(fit: ModelFit, weight: Array, free: Indices, label: Indices) -> Array:
    """Return for each block the best step from the blocks of all other labels, (B, K); ``label`` is (B,)."""
    place = np.unique(label, return_inverse=True)[1]
    steps = [
        solve_bounded_step(fit, product, gradient, free) for product, gradient in _complement_sums(fit, weight, place)
    ]
    return np.stack(steps)[place]


def _complement_sums(fit: ModelFit, weight: Array, place: Indices) -> list[tuple[Array, Array]]:
    """Return the normal equations without the blocks of each label 0, 1, ...; ``place``: label of each block, (B,)."""
    parts = [normal_equations(fit, weight, np.flatnonzero(place == k)) for k in range(int(place.max()) + 1)]
    product, gradient = (np.sum(sums, axis=0) for sums in zip(*parts, strict=True))
    return [(product - own, gradient - pull) for own, pull in parts]
