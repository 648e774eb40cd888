"""Exponentially weighted sums along rows. Letters: T rows."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEGLIGIBLE_SHARE = 1e-18  # Relative size of a term that is negligible in float64


def sum_with_decay(added: Array, kept: float) -> Array:
    """Return the exponential sum ``y_n = kept y_(n-1) + x_n`` of columns x (T, any), with ``y_0 = x_0``, ``0 <= kept <= 1``.

    Derived: a sum over 2 m rows is one over m rows, plus ``kept^m`` times that of the m rows before.
    """
    total, rows = added.copy(), 1
    while rows < len(total) and kept**rows > NEGLIGIBLE_SHARE:
        total[rows:] += kept**rows * total[:-rows]
        rows *= 2
    return total
