"""Guard against misspecified models: every effect must hold with the variance that the flights themselves show.

Evidence assumes that only noise remains. A model error is consistent within a flight but differs between flights, whose
parameters then scatter more than noise explains. This factor, the overdispersion, overstates the support of an effect.
Letters: F parts of the flights, k columns of one set, P those of one effect.

Sources: Liang, Zeger (1986), Longitudinal data analysis using generalized linear models, Biometrika 73 (variance from
clusters); Chandler, Bate (2007), Inference for clustered data using the independence loglikelihood, Biometrika 94; Pauli,
Racugno, Ventura (2011), Bayesian composite marginal likelihoods, Statistica Sinica 21 (a likelihood scaled by it).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.candidates.library import Library, law_relatives
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, NormalEquations, log_evidences, posterior
from aerial_gym.sim2real.identify.evidence.search import SetPosterior
from aerial_gym.sim2real.identify.least_squares.covariance import is_identifiable
from aerial_gym.sim2real.identify.least_squares.derivatives import parameter_row, parameter_scales
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    UNIT,
    WEAK_PRIOR,
    ModelFit,
    normal_equations_without_prior,
)


def make_candidates(library: Library) -> Candidates:
    """Return the candidates of a library as columns with bounds."""
    width = int(library.tolerances[-1]) + 1
    low, high = np.full(width, -np.inf), np.full(width, np.inf)
    for candidate in library.candidates:
        low[candidate.columns], high[candidate.columns] = candidate.low, candidate.high
    return Candidates(
        columns=tuple(candidate.columns for candidate in library.candidates),
        tolerances=library.tolerances,
        low=low,
        high=high,
        exclusive=tuple(candidate.name for candidate in library.candidates),
        apart=frozenset(
            frozenset((candidate.name, name))
            for candidate in library.candidates
            if not candidate.structure
            for name in law_relatives(candidate.name)
        ),
        structures=frozenset(k for k, candidate in enumerate(library.candidates) if candidate.structure),
    )


def make_normal_equations(library: Library, blocks: slice = slice(None)) -> NormalEquations:
    """Return the weighted normal equations over some blocks."""
    product = library.moments.product[blocks]
    alone = product.shape[:2] == (1, 1) and library.weight[0] == 1.0  # avoids a copy
    return NormalEquations(
        product=product[0, 0] if alone else np.einsum("c,bckl->kl", library.weight, product),
        gradient=np.einsum("c,bck->k", library.weight, library.moments.gradient[blocks]),
        constant=-0.5 * float(library.moments.square[blocks].sum(axis=0) @ library.weight),
    )


@dataclass(frozen=True, kw_only=True)
class LinearFit:
    """Linear model about a fitted set, in which each effect is one candidate."""

    candidates: Candidates
    whole: NormalEquations  # Normal equations with the constant that makes evidences of all sets comparable under equal weights
    parts: tuple[NormalEquations, ...]  # Normal equations of parts of the flights

    @property
    def set_of_all(self) -> Model:
        """Return the set of all candidates."""
        return tuple(range(len(self.candidates.columns)))


def linearise_about_fit(fit: ModelFit, neutral: Sequence[Array]) -> LinearFit:
    """Return the linear model about a fit with weighted moments, whose blocks are the parts, relative to neutral."""
    free, count = fit.indices_of_fitted_params, fit.indices_of_fitted_effect_params.size
    away = np.zeros(fit.low.size)
    if fit.effects:
        away[: fit.num_effect_params] = (
            parameter_row(fit.params, fit.effects) - np.concatenate(neutral)
        ) / parameter_scales(fit.effects)
    here, every = away[free], np.arange(fit.moments.count.size)

    def equations_of_blocks(own: Indices) -> NormalEquations:
        product, gradient = normal_equations_without_prior(fit, UNIT, own)
        product, gradient = product[np.ix_(free, free)], gradient[free]
        square = float(fit.moments.square[own].sum())
        constant = -0.5 * square - float(gradient @ here) - 0.5 * float(here @ product @ here)
        return NormalEquations(product=product, gradient=gradient + product @ here, constant=constant)

    low, high = (fit.low + away)[free], (fit.high + away)[free]
    low[count:], high[count:] = -np.inf, np.inf
    owners = [fit.parameter_owners[k][0] for k in fit.indices_of_fitted_effect_params]
    columns = tuple(np.flatnonzero([owner == name for owner in owners]) for name in fit.effects)
    candidates = Candidates(
        columns=columns, tolerances=np.arange(count, free.size), low=low, high=high, exclusive=fit.effects
    )
    parts = tuple(equations_of_blocks(every[[k]]) for k in every)
    return LinearFit(candidates=candidates, whole=equations_of_blocks(every), parts=parts)


FEWEST_PARTS = 4  # Least number of independent parts for the scatter


@dataclass(frozen=True, kw_only=True)
class Support:
    """Statistical support of an effect in a set, in the linear model."""

    log_odds: float  # Log posterior odds of the set with and without the effect, if only noise remains
    wald: float  # Wald statistic: squared distance from neutral over the covariance of noise and tolerances
    overdispersion: float  # Parameter variance from scatter between flights over that from noise, mean
    size: int  # Number P of parameters
    shown: bool = True  # Whether flights determine any of the parameters better than its scale

    @property
    def log_odds_with_overdispersion(self) -> float:
        """Return the log odds with the Wald statistic over the larger covariance.

        Occam's factor keeps that of noise; the larger one concealed a measured ground effect (docs/results/measured.md).
        """
        return self.log_odds - 0.5 * self.wald * (1.0 - 1.0 / max(self.overdispersion, 1.0))

    @property
    def is_supported(self) -> bool:
        """Return whether the effect is more probable than not."""
        return self.log_odds_with_overdispersion > 0.0


class Guard:
    """Removes effects that are less probable than not under the scatter between flights."""

    def __init__(self, library: Library, sets: SetPosterior) -> None:
        self._sets, self._candidates = sets, make_candidates(library)
        self._parts = [make_normal_equations(library, slice(k, k + 1)) for k in range(library.moments.count.size)]
        self._whole = make_normal_equations(library)
        self._support: dict[Model, dict[int, Support]] = {}

    def drop_unsupported(self, model: Model) -> Model:
        """Return a set after removal of its least supported candidate, structures included, repeated until all hold."""
        while (by_name := self.support(model)) and not all(one.is_supported for one in by_name.values()):
            weakest = min(by_name, key=lambda k: by_name[k].log_odds_with_overdispersion)
            model = tuple(k for k in model if k != weakest)
        return model

    def support(self, model: Model) -> dict[int, Support]:
        """Return the support of each candidate of a set."""
        if model not in self._support:
            values = self._sets.log_posteriors([model, *(tuple(k for k in model if k != gone) for gone in model)])
            odds = dict(zip(model, (values[0] - values[1:]).tolist(), strict=True))
            step = posterior(self._candidates, self._whole, model).step
            self._support[model] = supports_of_candidates(self._candidates, self._whole, self._parts, step, odds)
        return self._support[model]


def supports_of_fit(fit: LinearFit, step: Array, log_names: float) -> dict[str, Support]:
    """Return the support of each effect of a fitted set at its most probable ``step`` (k,)."""
    reduced, once = fit.candidates.without_tolerances(), fit.whole.marginal(fit.candidates.tolerances)
    values = log_evidences(
        reduced, once, [fit.set_of_all, *(tuple(k for k in fit.set_of_all if k != gone) for gone in fit.set_of_all)]
    )
    odds = dict(zip(fit.set_of_all, (values[0] - values[1:] - log_names).tolist(), strict=True))
    by_name = supports_of_candidates(fit.candidates, fit.whole, fit.parts, step, odds)
    return {fit.candidates.exclusive[k]: one for k, one in by_name.items()}


def supports_of_candidates(
    candidates: Candidates, whole: NormalEquations, parts: Sequence[NormalEquations], step: Array,
    log_odds: Mapping[int, float],
) -> dict[int, Support]:  # fmt: skip
    """Return the support of each candidate of a set, given its most probable ``step`` and log odds."""
    model = tuple(log_odds)
    columns, count = candidates.columns_of_set(model)
    precision = np.ones(columns.size)
    precision[:count] = 2.0 / (1.0 + step[:count] ** 2)  # of the Cauchy prior
    covariance = np.linalg.inv(whole.product[np.ix_(columns, columns)] + np.diag(precision))
    weak = np.concatenate((np.full(count, WEAK_PRIOR**-2), np.ones(columns.size - count)))
    told = is_identifiable(np.linalg.inv(whole.product[np.ix_(columns, columns)] + np.diag(weak)))
    whole_step = np.zeros(whole.gradient.size)
    whole_step[columns] = step
    scores = np.stack([(part.gradient - part.product @ whole_step)[columns] for part in parts])
    away = scores - scores.mean(axis=0)
    scatter = away.T @ away * (len(scores) / (len(scores) - 1))  # covariance of the sum of independent parts
    robust = covariance @ (scatter + np.diag(precision)) @ covariance
    by_name = {}
    for k, odds in log_odds.items():
        own = np.flatnonzero(np.isin(columns, candidates.columns[k]))
        block = np.ix_(own, own)
        wald, shown = float(step[own] @ np.linalg.solve(covariance[block], step[own])), bool(told[own].any())
        ratio = float(np.trace(np.linalg.solve(covariance[block], robust[block]))) / own.size
        by_name[k] = Support(log_odds=float(odds), wald=wald, overdispersion=ratio, size=own.size, shown=shown)
    return by_name


def num_parts_per_flight(num_flights: int) -> int:
    """Return the number of parts per flight that count as independent: one, or several for few flights."""
    return -(-FEWEST_PARTS // num_flights)
