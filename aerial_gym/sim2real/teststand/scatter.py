"""Least squares where the covariance of the rows is known only from a few repeats: exact tests and t intervals.

Letters: K rows, P parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from aerial_gym.sim2real.teststand.statistics import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """How much repeats under one condition differ."""

    squares: Array
    """Sums of squares and products about the mean of each group, (K, K)."""

    freedom: int
    """Repeats less groups."""

    @property
    def std(self) -> Array:
        """Standard deviation of one repeat, (K,)."""
        return np.sqrt(np.diag(self.squares) / self.freedom)

    def half_width(self, share: float) -> Array:
        """Return half the width of 95 % intervals of a mean or difference whose covariance is ``share`` times that of one
        repeat, (K,)."""
        return stats.t.ppf(0.975, self.freedom) * self.std * np.sqrt(share)

    def p_value(self, left: Array, covariance: Array) -> float:
        """Return the probability that scatter alone leaves as much or more, Hotelling's test.

        Args:
            left: What is left, (K,).
            covariance: Its covariance, (K, K).
        """
        size = left.size
        ratio = float(left @ np.linalg.solve(covariance, left)) / self.freedom
        return _tail(ratio, size, self.freedom - size + 1)


def pooled_scatter(groups: Sequence[Array]) -> Scatter:
    """Return the scatter within groups of repeats (N, K), the same in all groups; a group of one says nothing."""
    centred: Array = np.concatenate([group - group.mean(axis=0) for group in groups])
    return Scatter(squares=centred.T @ centred, freedom=len(centred) - len(groups))


@dataclass(frozen=True, kw_only=True)
class ScatterFit:
    """A straight model of rows with correlated scatter."""

    params: Array
    """(P,)."""

    covariance: Array
    """To be used with Student's t of ``freedom``, (P, P)."""

    freedom: int
    misfit: float
    """Probability that scatter alone leaves as much as this fit, or more."""

    gain: float
    """Probability that scatter alone would gain as much by these parameters, or more."""

    spread: Array = field(repr=False)
    """Covariance of the fitted rows if the rows had that of one repeat, (K, K)."""

    def ratio(self, upper: int, lower: int) -> Estimate | None:
        """Return the ratio of two parameters with its 95 % interval; None if the divisor may be 0, which leaves it open.

        Source: Fieller (1954), Some problems in interval estimation, Journal of the Royal Statistical Society B 16.
        """
        over, under = self.params[[upper, lower]]
        part = stats.t.ppf(0.975, self.freedom) ** 2 * self.covariance[np.ix_([upper, lower], [upper, lower])]
        square, middle = under**2 - part[1, 1], over * under - part[0, 1]
        if square <= 0.0:
            return None
        half_width = np.sqrt(max(middle**2 - square * (over**2 - part[0, 0]), 0.0))
        low, high = (middle - half_width) / square, (middle + half_width) / square
        return Estimate(value=float(over / under), low=float(low), high=float(high))


def fit_scatter(target: Array, columns: Array, scatter: Scatter, share: float) -> ScatterFit:
    """Return the fit of ``target = columns params``; scatter needs at least as much freedom as there are rows.

    Args:
        target: Rows (K,), with ``share`` times the covariance of one repeat.
        columns: (K, P), P < K; P = 0: nothing is fitted.
        scatter: Between repeats.
        share: 1 for one repeat, 1/N for the mean of N, their sum for a difference.

    Source:
        Rao (1965), The theory of least squares when the parameters are stochastic, Biometrika 52: what no parameter explains
        serves as covariates, so that intervals and F tests are exact for normal scatter that was estimated.
    """
    size, count = columns.shape
    weight = np.linalg.inv(scatter.squares)
    bread = np.linalg.inv(columns.T @ weight @ columns)
    params = bread @ columns.T @ weight @ target
    left = target - columns @ params
    still, before = float(left @ weight @ left), float(target @ weight @ target)
    freedom = scatter.freedom - (size - count)
    rest = scatter.freedom - size + 1
    return ScatterFit(
        params=params,
        covariance=bread * (share + still) / freedom,
        freedom=freedom,
        misfit=_tail(still / share, size - count, rest + count),
        gain=_tail((before - still) / (share + still), count, rest) if count else 1.0,
        spread=scatter.freedom**-1 * columns @ bread @ columns.T,
    )


def _tail(ratio: float, count: int, freedom: int) -> float:
    """Return the upper tail of F for a ratio of sums of squares."""
    return float(stats.f.sf(ratio * freedom / count, count, freedom))
