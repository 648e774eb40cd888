"""Derivatives of predictions by parameters: how they are kept, and how they are mended along a step.

Letters: C channels, P parameters.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Derivatives = Sequence[NDArray[np.floating]]
"""By some parameters, per scale, of each flight, (rows, C, P)."""


def column_by_column(like: Array, parameters: int) -> Array:
    """Return zeros (rows, C, P) for a prediction (rows, C); neighbours in memory are rows, as they are written and read."""
    return np.zeros((parameters, *like.T.shape)).T


def change_along(columns: NDArray[np.floating], step: Array) -> Array:
    """Return what derivatives of a flight (rows, C, P) say of a step (P,), (rows, C)."""
    return np.tensordot(step, columns.T, axes=1).T


def exact_along(columns: Sequence[Array], step: Array, change: Sequence[Array]) -> None:
    """Change derivatives (rows, C, k) in place, as little as gives exactly the ``change`` (rows, C) over a ``step`` (k).

    A lag of 0 and one of 0.06 s differ by much more or less than what the derivative at 0.06 s says.

    Source:
        Broyden (1965), A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19.
    """
    if not np.any(step):
        return
    along = step / (step @ step)
    for own, moved in zip(columns, change, strict=True):
        missed = moved - change_along(own, step)
        for k in np.flatnonzero(along):
            own[:, :, k] += along[k] * missed


def single(columns: Derivatives) -> Derivatives:
    """Return derivatives in single precision, in which they are kept: differences of predictions know no more digits."""
    return [part.astype(np.float32) for part in columns]
