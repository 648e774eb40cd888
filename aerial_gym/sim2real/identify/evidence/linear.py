"""Normal equations of linear models about a fit, as input of the evidence."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.candidates.library import Library
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, NormalEquations
from aerial_gym.sim2real.identify.least_squares.gauss_newton import UNIT, ModelFit, normal_equations_without_prior
from aerial_gym.sim2real.identify.least_squares.parameters import parameter_row, parameter_scales


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
            for name in EFFECTS.get(candidate.name).contains
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
