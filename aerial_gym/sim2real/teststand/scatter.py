"""Least squares where the covariance of the rows is known only from a few repeats: exact tests, t intervals and evidence.

Letters: K rows, P parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.teststand.statistics import Estimate


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
        columns: (K, P); P = 0: nothing is fitted.
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
    still = float(left @ weight @ left)
    freedom = scatter.freedom - (size - count)
    rest = scatter.freedom - size + 1
    return ScatterFit(
        params=params,
        covariance=bread * (share + still) / freedom,
        freedom=freedom,
        misfit=_tail(still / share, size - count, rest + count) if size > count else 1.0,
        spread=scatter.freedom**-1 * columns @ bread @ columns.T,
    )


NODES = 32
"""Steps of each of the two integrals of the evidence; twice as many move no probability by 0.001."""


def log_evidence(target: Array, columns: Array, scatter: Scatter, share: float) -> float:
    """Return the logarithm of how probable ``target = columns params`` makes the rows, whatever the parameters.

    What the parameters do to the rows is normal and of one size in all directions that the columns span. That size is anything
    from that of the scatter to 1 (a change by the whole), evenly in its logarithm. More columns spread the same probability
    over more changes: they win only if the rows ask for them.

    Args:
        target: Rows (K,), relative changes, with ``share`` times the covariance of one repeat.
        columns: (K, P); P = 0: nothing changed; P = K: anything may have.
        scatter: Between repeats, of a covariance of which nothing else is known; its freedom must be at least K.
        share: As in `fit_scatter`.

    Source:
        Jeffreys (1961), Theory of probability, chapter 5, and its prior for a scale. Geisser, Cornfield (1963), Posterior
        distributions for multivariate normal parameters, Journal of the Royal Statistical Society B 25: a repeat has Student's
        distribution of ``freedom - K + 1``, which is normal with the covariance ``squares / w``, w from chi² of as many
        degrees (Andrews, Mallows 1974, Scale mixtures of normal distributions, same journal, B 36).
    """
    root = np.linalg.cholesky(share * scatter.squares)
    basis, _ = np.linalg.qr(columns)
    white = np.linalg.solve(root, basis)
    effect, axes = np.linalg.eigh(white @ white.T)
    rows = axes.T @ np.linalg.solve(root, target)
    degrees = scatter.freedom - target.size + 1
    middle = (np.arange(NODES) + 0.5) / NODES
    low, high = np.log(stats.chi2.ppf((1e-6, 1.0 - 1e-6), degrees))
    log_w = low + (high - low) * middle
    weight = stats.chi2.logpdf(np.exp(log_w), degrees) + log_w
    least = min(np.log(scatter.std @ scatter.std * share / target.size) / 2.0, 0.0)
    size = np.exp(2.0 * least * middle)
    variance = np.exp(-log_w)[:, None, None] + size[:, None] * np.maximum(effect, 0.0)
    fit = -0.5 * (np.log(variance) + rows**2 / variance).sum(axis=2)
    whole = np.logaddexp.reduce((fit + weight[:, None]).ravel()) - np.logaddexp.reduce(weight) - np.log(NODES)
    return float(whole - np.log(np.diag(root)).sum())


def _tail(ratio: float, count: int, freedom: int) -> float:
    """Return the upper tail of F for a ratio of sums of squares."""
    return float(stats.f.sf(ratio * freedom / count, count, freedom))
