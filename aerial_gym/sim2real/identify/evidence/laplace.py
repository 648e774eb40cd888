"""How probable a set of effects makes the flights: the log evidence, by Laplace's approximation.

A model is linear about a point: residual r = J x + noise, x the parameters of a set of effects in units of their scale, and
the deviations within the tolerances of the declared vehicle. The evidence of a set is what the flights are worth on the
average over its prior, ``Z = integral L(x) p(x) dx``. So it weighs fit against parsimony by itself: what a set could also
have predicted, and did not happen, counts against it. Deviations have normal priors, for a tolerance is a standard
deviation; parameters of effects have Cauchy priors about neutral, whose width is the parameter's scale and whose tails let
a parameter be ten times larger without much ado.

Letters: K columns of a library, k columns of one set, P of them parameters of effects.

Sources:
    Kass, Raftery (1995), Bayes factors, Journal of the American Statistical Association 90 (Laplace, section 4.1);
    Jeffreys (1961), Theory of Probability, section 5.2 (Cauchy priors).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Model = tuple[int, ...]
"""Places of the candidates that are in a set, in rising order."""

MOST_STEPS = 30
"""Of the search for the best parameters under the Cauchy priors."""

CONVERGED = 1e-6
"""Relative to a parameter's scale."""


@dataclass(frozen=True, kw_only=True)
class Normal:
    """Sums over flights that a linear model needs: the log likelihood is ``gradient x - x product x / 2``, up to a constant."""

    product: Array
    """``sum w J J^T``, (K, K)."""

    gradient: Array
    """``sum w J r``, (K,)."""

    def __sub__(self, other: "Normal") -> "Normal":
        """Return the sums without those of some flights."""
        return Normal(product=self.product - other.product, gradient=self.gradient - other.gradient)


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """The best parameters of one set, how well they are known, and the evidence of the set."""

    columns: Indices
    """Columns of the set, the tolerances behind, (k,)."""

    step: Array
    """Most probable values, in units of scale or tolerance, (k,)."""

    covariance: Array
    """Of the normal distribution about them, (k, k)."""

    log_evidence: float


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """What a set is made of."""

    columns: tuple[Indices, ...]
    """Columns of each candidate."""

    tolerances: Indices
    """Columns of the tolerances."""

    low: Array
    """Lowest possible step of each column, in units of its scale, (K,); minus infinity where there is none."""

    high: Array
    """Highest, (K,)."""

    exclusive: tuple[str, ...]
    """Name of each candidate; a set has no two of one name: one effect from several starts, or on several rotors."""

    def columns_of(self, model: Model) -> tuple[Indices, int]:
        """Return the columns of a set, the tolerances behind, and how many of them belong to effects."""
        own = [self.columns[k] for k in model]
        count = sum(columns.size for columns in own)
        return np.concatenate([*own, self.tolerances]).astype(np.int64), count


def posterior(candidates: Candidates, normal: Normal, model: Model) -> Posterior:
    """Return the posterior of one set's parameters, and its evidence by Laplace's approximation.

    The Cauchy prior is a normal one whose precision depends on where the parameter is; the best parameters come by solving
    with that precision again until it no longer changes. Bounds cut prior and posterior off: the evidence is multiplied by
    the share of the posterior within them and divided by that of the prior: exact for a single parameter with a normal prior.
    Of a parameter that nothing shows it is 0.56 in place of 1, the share of a Cauchy density that its normal one covers.
    """
    columns, count = candidates.columns_of(model)
    product, gradient = normal.product[np.ix_(columns, columns)], normal.gradient[columns]
    precision, step = np.ones(columns.size), np.zeros(columns.size)
    for _ in range(MOST_STEPS):
        before, step = step, np.linalg.solve(product + np.diag(precision), gradient)
        precision[:count] = 2.0 / (1.0 + step[:count] ** 2)
        if np.max(np.abs(step - before), initial=0.0) < CONVERGED:
            break
    covariance = np.linalg.inv(product + np.diag(precision))
    effects, deviations = step[:count], step[count:]
    log_prior = -np.log(np.pi * (1.0 + effects**2)).sum() - 0.5 * (deviations**2 + np.log(2.0 * np.pi)).sum()
    log_likelihood = gradient @ step - 0.5 * step @ product @ step
    log_volume = 0.5 * (columns.size * np.log(2.0 * np.pi) + np.linalg.slogdet(covariance)[1])
    low, high = candidates.low[columns[:count]], candidates.high[columns[:count]]
    std = np.sqrt(np.diag(covariance)[:count])
    within = _log_normal_between((low - effects) / std, (high - effects) / std) - _log_cauchy_between(low, high)
    return Posterior(
        columns=columns,
        step=step,
        covariance=covariance,
        log_evidence=float(log_likelihood + log_prior + log_volume + within.sum()),
    )


def _log_normal_between(low: Array, high: Array) -> Array:
    """Return the log probability that a standard normal number lies between two bounds."""
    flip = low > 0.0  # in the lower tail, where it is exact
    low, high = np.where(flip, -high, low), np.where(flip, -low, high)
    top, bottom = log_ndtr(high), log_ndtr(low)
    return top + np.log1p(-np.exp(np.minimum(bottom - top, -1e-15)))


def _log_cauchy_between(low: Array, high: Array) -> Array:
    """Return the log probability that a standard Cauchy number lies between two bounds."""
    return np.log((np.arctan(high) - np.arctan(low)) / np.pi)
