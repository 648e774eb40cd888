"""Linear models with known noise, as sums: candidates that share what they explain, and tolerances behind them."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from aerial_gym.sim2real.identify.evidence.laplace import Candidates, NormalEquations

Array = NDArray[np.float64]


def candidates(*widths: int, num_tolerances: int = 0, names: tuple[str, ...] = (), low: float = -np.inf) -> Candidates:
    """Return candidates with so many columns each, and tolerances behind them."""
    ends = np.cumsum((0, *widths))
    total = int(ends[-1]) + num_tolerances
    return Candidates(
        columns=tuple(np.arange(a, b) for a, b in pairwise(ends)),
        tolerances=np.arange(ends[-1], total),
        low=np.full(total, low),
        high=np.full(total, np.inf),
        exclusive=names or tuple(f"effect_{k}" for k in range(len(widths))),
    )


def normal(columns: Array, measured: Array) -> NormalEquations:
    """Return the sums of derivatives (rows, K) and measurements (rows,) with noise of one."""
    return NormalEquations(product=columns.T @ columns, gradient=columns.T @ measured)
