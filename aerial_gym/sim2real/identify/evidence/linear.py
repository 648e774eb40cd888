"""The linear model about a fitted one as the sums of which evidences are made, and the evidence of a nonlinear fit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.candidates.library import Library
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, Normal
from aerial_gym.sim2real.identify.least_squares.gauss_newton import UNIT, Fit, normal_equations
from aerial_gym.sim2real.identify.least_squares.parameters import params_of, scales


def candidates_of(library: Library) -> Candidates:
    """Return what sets are made of."""
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


def normal_of(library: Library, blocks: slice = slice(None)) -> Normal:
    """Return the weighted sums over some blocks."""
    product = library.moments.product[blocks]
    alone = product.shape[:2] == (1, 1) and library.weight[0] == 1.0  # then it need not be held a second time
    return Normal(
        product=product[0, 0] if alone else np.einsum("c,bckl->kl", library.weight, product),
        gradient=np.einsum("c,bck->k", library.weight, library.moments.gradient[blocks]),
        constant=-0.5 * float(library.moments.square[blocks].sum(axis=0) @ library.weight),
    )


@dataclass(frozen=True, kw_only=True)
class LinearFit:
    """The linear model about a fitted set: each effect is a candidate, and the set is all of them."""

    candidates: Candidates
    whole: Normal
    """With the constant by which the evidences of all sets under one weighting are comparable."""

    parts: tuple[Normal, ...]
    """Those of parts of the flights."""

    @property
    def model(self) -> Model:
        """Return the set."""
        return tuple(range(len(self.candidates.columns)))


def linear_about(fit: Fit, neutral: Sequence[Array]) -> LinearFit:
    """Return the linear model about a fit, its parameters counted from neutral.

    Args:
        fit: Effects, tolerances and structures, with the weights in its moments; its blocks are the parts.
        neutral: Parameters with which each effect changes nothing.
    """
    free, count = fit.free_all, fit.free_effects.size
    away = np.zeros(fit.low.size)
    if fit.effects:
        away[: fit.num_effect_params] = (params_of(fit.params, fit.effects) - np.concatenate(neutral)) / scales(
            fit.effects
        )
    here, every = away[free], np.arange(fit.moments.count.size)

    def normal(own: Indices) -> Normal:
        product, gradient = normal_equations(fit, UNIT, own)
        product, gradient = product[np.ix_(free, free)], gradient[free]
        square = float(fit.moments.square[own].sum())
        constant = -0.5 * square - float(gradient @ here) - 0.5 * float(here @ product @ here)
        return Normal(product=product, gradient=gradient + product @ here, constant=constant)

    low, high = (fit.low + away)[free], (fit.high + away)[free]
    low[count:], high[count:] = -np.inf, np.inf
    owners = [fit.owners[k][0] for k in fit.free_effects]
    columns = tuple(np.flatnonzero([owner == name for owner in owners]) for name in fit.effects)
    return LinearFit(
        candidates=Candidates(
            columns=columns, tolerances=np.arange(count, free.size), low=low, high=high, exclusive=fit.effects
        ),
        whole=normal(every),
        parts=tuple(normal(every[[k]]) for k in every),
    )
