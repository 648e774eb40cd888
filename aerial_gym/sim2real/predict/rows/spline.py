"""A cubic spline through the rows of several flights, none of which feels another: what was sampled, at other times.

Of one flight it is ``scipy.interpolate.CubicSpline``. A prediction asks for it again and again with other values at the same
rows: all flights at once, with the equations of their rows factorised once, took 0.4 ms in place of 3.5 for five flights.
"""

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import block_diag, csc_array, csr_array
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]

DELAYS_KEPT = 8
"""Sets of delays of which the spline is kept: those of the sensors of the present model, and of one that differs in some."""


class Spline:
    """Cubic splines without a knot at the second row and the last but one, through values at the rows of flights."""

    def __init__(self, times: Sequence[Array]) -> None:
        """Take the times of the rows of each flight [s], increasing, (rows,)."""
        self._times = times
        self._moved = lru_cache(DELAYS_KEPT)(self._terms_later)

    @cached_property
    def _solve(self) -> Callable[[Array], Array]:
        """Return what gives the coefficients of columns (rows of all flights, any); many flights are never asked."""
        return splu(csc_array(block_diag([_terms(time, time) for time in self._times], format="csc"))).solve

    def later(self, columns: Sequence[Array], seconds: Sequence[float]) -> list[Array]:
        """Return columns (rows of all flights,) as they are so many seconds later in each flight."""
        if not any(seconds):
            return list(columns)
        coefficients = self._solve(np.stack(columns, axis=1))
        return list(np.ascontiguousarray((self._moved(tuple(seconds)) @ coefficients).T))

    def _terms_later(self, seconds: tuple[float, ...]) -> csr_array:
        """Return what the coefficients of all flights give so many seconds before their rows."""
        terms = [_terms(time, time - late) for time, late in zip(self._times, seconds, strict=True)]
        return csr_array(block_diag(terms, format="csr"))


def _terms(time: Array, at: Array) -> csr_array:
    """Return what each basis function of the spline through rows at some times is at others, (others, rows)."""
    degree = min(3, time.size - 1)
    inner = time[2:-2] if degree == 3 else time[:0]
    knots = np.concatenate((np.repeat(time[0], degree + 1), inner, np.repeat(time[-1], degree + 1)))
    return BSpline.design_matrix(at, knots, degree, extrapolate=True)
