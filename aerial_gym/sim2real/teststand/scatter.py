"""Least squares with a row covariance estimated from few repeats: exact tests, t intervals and evidence.

Letters: K rows, P parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import special

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.statistics import Estimate, student_quantile


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """Covariance of repeats under one condition."""

    squares: Array  # Sums of squares and products about the group means, (K, K)
    freedom: int  # Degrees of freedom: repeats minus groups

    @property
    def std(self) -> Array:
        """Standard deviation of one repeat, (K,)."""
        return np.sqrt(np.diag(self.squares) / self.freedom)

    def half_width(self, share: float) -> Array:
        """Return half the 95 % interval of a mean or difference with covariance ``share`` times that of one repeat, (K,)."""
        return student_quantile(0.975, self.freedom) * self.std * np.sqrt(share)

    def p_value(self, left: Array, covariance: Array) -> float:
        """Return the p-value of a residual (K,) with a covariance (K, K) under scatter alone, by Hotelling's test."""
        size = left.size
        ratio = float(left @ np.linalg.solve(covariance, left)) / self.freedom
        return _f_tail_probability(ratio, size, self.freedom - size + 1)


def pool_scatter(groups: Sequence[Array]) -> Scatter:
    """Return the common scatter within groups of repeats (N, K); groups of one do not contribute."""
    centred: Array = np.concatenate([group - group.mean(axis=0) for group in groups])
    return Scatter(squares=centred.T @ centred, freedom=len(centred) - len(groups))


@dataclass(frozen=True)
class ScatterFit:
    """Linear model of rows with correlated scatter."""

    params: Array  # Parameters, (P,)
    covariance: Array  # Covariance for Student's t with ``freedom``, (P, P)
    freedom: int
    misfit: float  # P-value of the residual under scatter alone
    spread: Array = field(repr=False)  # Covariance of the fitted rows if each row has that of one repeat, (K, K)

    def ratio_of_parameters(self, upper: int, lower: int) -> Estimate | None:
        """Return the ratio of two parameters with its 95 % interval; None if the divisor may be 0.

        Source: Fieller (1954), Some problems in interval estimation, Journal of the Royal Statistical Society B 16.
        """
        over, under = self.params[[upper, lower]]
        part = student_quantile(0.975, self.freedom) ** 2 * self.covariance[np.ix_([upper, lower], [upper, lower])]
        square, middle = under**2 - part[1, 1], over * under - part[0, 1]
        if square <= 0.0:
            return None
        half_width = np.sqrt(max(middle**2 - square * (over**2 - part[0, 0]), 0.0))
        low, high = (middle - half_width) / square, (middle + half_width) / square
        return Estimate(value=float(over / under), low=float(low), high=float(high))


def fit_scatter(target: Array, columns: Array, scatter: Scatter, share: float) -> ScatterFit:
    """Return the fit of ``target = columns params``; the scatter needs at least K degrees of freedom.

    Args:
        target: Rows (K,) with ``share`` times the covariance of one repeat.
        columns: Regressors (K, P); P = 0: no fit.
        share: 1 for one repeat, 1/N for the mean of N, their sum for a difference.

    Source:
        Rao (1965), The theory of least squares when the parameters are stochastic, Biometrika 52: unexplained
        combinations of rows are covariates, so intervals and F tests are exact for normal scatter.
    """
    size, count = columns.shape
    weight = np.linalg.inv(scatter.squares)
    bread = np.linalg.inv(columns.T @ weight @ columns)
    params = bread @ columns.T @ weight @ target
    left = target - columns @ params
    still = float(left @ weight @ left)
    freedom, spread = scatter.freedom - (size - count), scatter.freedom**-1 * columns @ bread @ columns.T
    misfit = _f_tail_probability(still / share, size - count, freedom + 1) if size > count else 1.0
    return ScatterFit(params, bread * (share + still) / freedom, freedom, misfit, spread)


NODES = 32  # Nodes of each of the two evidence integrals; twice as many change no probability by 0.001


def log_evidence_of_cause(target: Array, columns: Array, scatter: Scatter, share: float) -> float:
    """Return the log evidence that a cause with these regressors made the changes ``target = columns params``.

    Their effect on the rows has an isotropic normal prior in the columns' span. Its size is log-uniform between the scatter
    and 1 (a change by 100 %). More columns spread the same probability over more changes, so they win only if needed.

    Args:
        target: Relative changes (K,) with ``share`` times the covariance of one repeat.
        columns: Regressors (K, P); P = 0: no change; P = K: any change.
        scatter: Scatter of repeats with at least K degrees of freedom, the only information on the covariance.
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
    low, high = np.log(2.0 * special.gammaincinv(0.5 * degrees, (1e-6, 1.0 - 1e-6)))
    log_w = low + (high - low) * middle
    weight = 0.5 * (degrees * log_w - np.exp(log_w))  # log density of log w for chi², up to a constant
    least = min(np.log(scatter.std @ scatter.std * share / target.size) / 2.0, 0.0)
    size = np.exp(2.0 * least * middle)
    variance = np.exp(-log_w)[:, None, None] + size[:, None] * np.maximum(effect, 0.0)
    fit = -0.5 * (np.log(variance) + rows**2 / variance).sum(axis=2)
    whole = np.logaddexp.reduce((fit + weight[:, None]).ravel()) - np.logaddexp.reduce(weight) - np.log(NODES)
    return float(whole - np.log(np.diag(root)).sum())


def _f_tail_probability(ratio: float, count: int, freedom: int) -> float:
    """Return the upper tail probability of F for a ratio of sums of squares."""
    return float(special.fdtrc(count, freedom, ratio * freedom / count))
