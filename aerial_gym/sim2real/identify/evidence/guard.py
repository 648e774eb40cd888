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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.candidates.library import Library
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, Normal, log_evidences, posterior
from aerial_gym.sim2real.identify.evidence.linear import LinearFit, candidates_of, normal_of
from aerial_gym.sim2real.identify.evidence.search import Sets
from aerial_gym.sim2real.identify.least_squares.covariance import shown
from aerial_gym.sim2real.identify.least_squares.gauss_newton import WEAK_PRIOR

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

    size: int
    """Number P of its parameters."""

    shown: bool = True
    """Whether flights tell any of them better than by its scale, whatever they may be."""

    @property
    def robust_log_odds(self) -> float:
        """Return the log odds with the distance over the larger of the two covariances.

        Occam's factor stays that of noise, the stricter one: with the larger covariance there as well, structures were let in
        beside which a measured ground effect was lost (docs/results/measured.md).
        """
        return self.log_odds - 0.5 * self.wald * (1.0 - 1.0 / max(self.overdispersion, 1.0))

    @property
    def holds(self) -> bool:
        """Return whether the effect is more probable than not."""
        return self.robust_log_odds > 0.0


class Guard:
    """Takes out of sets what is less probable than not when parameters are as sure as flights agree on them."""

    def __init__(self, library: Library, sets: Sets) -> None:
        """Take the posterior over sets of a library of candidates."""
        self._sets, self._candidates = sets, candidates_of(library)
        self._parts = [normal_of(library, slice(k, k + 1)) for k in range(library.moments.count.size)]
        self._whole = normal_of(library)
        self._support: dict[Model, dict[int, Support]] = {}

    def held(self, model: Model) -> Model:
        """Return what is left of a set when that for which the least speaks goes, until all that is left holds.

        Structures are held to it as well: what remains in one flight as in no other has no structure.
        """
        while (found := self.of(model)) and not all(one.holds for one in found.values()):
            weakest = min(found, key=lambda k: found[k].robust_log_odds)
            model = tuple(k for k in model if k != weakest)
        return model

    def of(self, model: Model) -> dict[int, Support]:
        """Return what speaks for each candidate of a set."""
        if model not in self._support:
            values = self._sets.log_posterior_of([model, *(tuple(k for k in model if k != gone) for gone in model)])
            odds = dict(zip(model, (values[0] - values[1:]).tolist(), strict=True))
            step = posterior(self._candidates, self._whole, model).step
            self._support[model] = supports(self._candidates, self._whole, self._parts, step, odds)
        return self._support[model]


def supports_of_fit(fit: LinearFit, step: Array, log_names: float) -> dict[str, Support]:
    """Return what speaks for each effect of a fitted set, about the fit, whose most probable ``step`` is given, (k,)."""
    reduced, once = fit.candidates.without_tolerances(), fit.whole.marginal(fit.candidates.tolerances)
    values = log_evidences(
        reduced, once, [fit.model, *(tuple(k for k in fit.model if k != gone) for gone in fit.model)]
    )
    odds = dict(zip(fit.model, (values[0] - values[1:] - log_names).tolist(), strict=True))
    found = supports(fit.candidates, fit.whole, fit.parts, step, odds)
    return {fit.candidates.exclusive[k]: one for k, one in found.items()}


def supports(
    candidates: Candidates, whole: Normal, parts: Sequence[Normal], step: Array, log_odds: Mapping[int, float]
) -> dict[int, Support]:
    """Return what speaks for each candidate of a set, whose most probable ``step`` and log odds without each are given."""
    model = tuple(log_odds)
    columns, count = candidates.columns_of(model)
    precision = np.ones(columns.size)
    precision[:count] = 2.0 / (1.0 + step[:count] ** 2)  # of the Cauchy prior there
    covariance = np.linalg.inv(whole.product[np.ix_(columns, columns)] + np.diag(precision))
    weak = np.concatenate((np.full(count, WEAK_PRIOR**-2), np.ones(columns.size - count)))
    told = shown(np.linalg.inv(whole.product[np.ix_(columns, columns)] + np.diag(weak)))
    scores = np.stack([part.gradient[columns] - part.product[np.ix_(columns, columns)] @ step for part in parts])
    robust = covariance @ (scatter(scores) + np.diag(precision)) @ covariance
    found = {}
    for k, odds in log_odds.items():
        own = np.flatnonzero(np.isin(columns, candidates.columns[k]))
        block = np.ix_(own, own)
        found[k] = Support(
            log_odds=float(odds),
            wald=float(step[own] @ np.linalg.solve(covariance[block], step[own])),
            overdispersion=float(np.trace(np.linalg.solve(covariance[block], robust[block]))) / own.size,
            size=own.size,
            shown=bool(told[own].any()),
        )
    return found


def scatter(scores: Array) -> Array:
    """Return the covariance (k, k) of the sum of scores (F, k) of independent parts, from the scatter between them."""
    away = scores - scores.mean(axis=0)
    return away.T @ away * (len(scores) / (len(scores) - 1))


def parts_of_a_flight(num_flights: int) -> int:
    """Return in how many parts each flight is, that are taken as independent: one, or several if flights are few."""
    return -(-FEWEST_PARTS // num_flights)
