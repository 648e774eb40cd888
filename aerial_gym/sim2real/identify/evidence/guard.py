"""The guard against a model that is not the vehicle's: every effect must hold when flights themselves say how sure they are.

Evidence weighs sets as if one of them were true and noise alone were left. Where none is true, what a set misses is the same
again and again within a flight and another in the next: parameters then scatter more between flights than noise would make
them. By this factor, their overdispersion, an effect speaks for itself too loudly.

Letters: F parts of the flights, k columns of one set, P those of one effect.

Sources:
    Liang, Zeger (1986), Longitudinal data analysis using generalized linear models, Biometrika 73 (variance from clusters);
    Chandler, Bate (2007), Inference for clustered data using the independence loglikelihood, Biometrika 94, and Pauli,
    Racugno, Ventura (2011), Bayesian composite marginal likelihoods, Statistica Sinica 21 (a likelihood scaled by it).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, Normal, posterior
from aerial_gym.sim2real.identify.evidence.linear import LinearFit, candidates_of, normal_of
from aerial_gym.sim2real.identify.evidence.search import Sets
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.library import Library

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FEWEST_PARTS = 4
"""Between which the scatter is taken: fewer do not tell one."""


@dataclass(frozen=True, kw_only=True)
class Support:
    """How much speaks for an effect of a set, in the linear model."""

    log_odds: float
    """Log posterior odds of the set with and without it, if the noise is all that the set misses."""

    wald: float
    """Squared distance of its parameters from neutral, over their covariance by noise and tolerances."""

    overdispersion: float
    """Variance of its parameters by the scatter between flights over that by noise, the mean over its parameters."""

    @property
    def robust_log_odds(self) -> float:
        """Return the log odds with the distance over the larger of the two covariances."""
        return self.log_odds - 0.5 * self.wald * (1.0 - 1.0 / max(self.overdispersion, 1.0))


class Guard:
    """Keeps out sets with an effect that is less probable than not when parameters are as sure as flights agree on them."""

    def __init__(self, library: Library, sets: Sets, weights: Weighting) -> None:
        """Take the posterior over sets of a library of candidates."""
        self._library, self._sets, self._candidates = library, sets, candidates_of(library)
        self._parts = [normal_of(library, weights, np.array([k])) for k in range(library.moments.count.size)]
        self._whole = normal_of(library, weights)
        self._support: dict[Model, dict[str, Support]] = {}

    def passes(self, model: Model) -> bool:
        """Return whether every effect of a set holds."""
        return all(found.robust_log_odds > 0.0 for found in self.of(model).values())

    def of(self, model: Model) -> dict[str, Support]:
        """Return what speaks for each effect of a set."""
        if model not in self._support:
            self._support[model] = self._supports(model)
        return self._support[model]

    def _supports(self, model: Model) -> dict[str, Support]:
        effects = [k for k in model if k not in self._sets.candidates.structures]
        values = self._sets.look([model, *(tuple(k for k in model if k != gone) for gone in effects)])
        found = supports(self._candidates, self._whole, self._parts, model, values[0] - values[1:])
        return {self._library.candidates[k].name: one for k, one in zip(effects, found, strict=True)}


def supports_of_fit(fit: LinearFit, log_names: float) -> dict[str, Support]:
    """Return what speaks for each effect of a fitted set, about the fit."""
    whole = posterior(fit.candidates, fit.whole, fit.model).log_evidence
    less = [tuple(k for k in fit.model if k != gone) for gone in fit.model]
    odds = [whole - posterior(fit.candidates, fit.whole, model).log_evidence - log_names for model in less]
    found = supports(fit.candidates, fit.whole, fit.parts, fit.model, odds)
    return dict(zip(fit.candidates.exclusive, found, strict=True))


def supports(
    candidates: Candidates, whole: Normal, parts: Sequence[Normal], model: Model, log_odds: Iterable[float]
) -> list[Support]:
    """Return what speaks for each effect of a set, whose log odds against the set without it are given."""
    columns, count = candidates.columns_of(model)
    step = posterior(candidates, whole, model).step
    precision = np.ones(columns.size)
    precision[:count] = 2.0 / (1.0 + step[:count] ** 2)  # of the Cauchy prior there
    covariance = np.linalg.inv(whole.product[np.ix_(columns, columns)] + np.diag(precision))
    scores = np.stack([part.gradient[columns] - part.product[np.ix_(columns, columns)] @ step for part in parts])
    robust = covariance @ (scatter(scores) + np.diag(precision)) @ covariance
    found, start = [], 0
    for k, odds in zip((k for k in model if k not in candidates.structures), log_odds, strict=True):
        own = slice(start, start + candidates.columns[k].size)
        start = own.stop
        found.append(
            Support(
                log_odds=float(odds),
                wald=float(step[own] @ np.linalg.solve(covariance[own, own], step[own])),
                overdispersion=float(np.trace(np.linalg.solve(covariance[own, own], robust[own, own])))
                / candidates.columns[k].size,
            )
        )
    return found


def scatter(scores: Array) -> Array:
    """Return the covariance (k, k) of the sum of scores (F, k) of independent parts, from the scatter between them."""
    away = scores - scores.mean(axis=0)
    return away.T @ away * (len(scores) / (len(scores) - 1))


def part_length(times: Sequence[Array]) -> float:
    """Return how long the parts are that are taken as independent [s]: whole flights, or parts of them if flights are few."""
    if len(times) >= FEWEST_PARTS:
        return np.inf
    shortest = min(float(time[-1] - time[0]) for time in times)
    return shortest / -(-FEWEST_PARTS // len(times))


def parts_of(flight: Indices) -> Indices:
    """Return the part of each block, (B,): its flight, or its place in it where flights are few; ``flight`` is (B,)."""
    labels, place = np.unique(flight, return_inverse=True)
    if labels.size >= FEWEST_PARTS:
        return place
    each, found = -(-FEWEST_PARTS // labels.size), np.zeros_like(place)
    for k in range(labels.size):
        own = np.flatnonzero(place == k)
        found[own] = k * each + np.arange(own.size) * each // own.size
    return found
