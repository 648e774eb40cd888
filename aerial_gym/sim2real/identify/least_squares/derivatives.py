"""Derivatives of predictions by parameters: how they are kept, and how they are mended along a step.

Letters: C channels, P parameters.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Derivatives = Sequence[NDArray[np.floating]]
"""By some parameters, per scale, of each flight, (rows, C, P)."""


def exact_along(columns: Sequence[Array], step: Array, change: Sequence[Array]) -> list[Array]:
    """Return derivatives (rows, C, k), changed as little as gives exactly the ``change`` (rows, C) over a ``step`` (k).

    A lag of 0 and one of 0.06 s differ by much more or less than what the derivative at 0.06 s says.

    Source:
        Broyden (1965), A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19.
    """
    if not np.any(step):
        return list(columns)
    along = step / (step @ step)
    return [c + (d - c @ step)[..., None] * along for c, d in zip(columns, change, strict=True)]


def single(columns: Derivatives) -> Derivatives:
    """Return derivatives in single precision, in which they are kept: differences of predictions know no more digits."""
    return [part.astype(np.float32) for part in columns]
