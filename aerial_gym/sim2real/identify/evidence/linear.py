"""The linear model about a fitted one as the sums of which evidences are made, and the evidence of a nonlinear fit."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, Normal, Posterior, posterior
from aerial_gym.sim2real.identify.evidence.structure import Structure
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit, normal_equations, params_of, scales
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.library import Library

Array = NDArray[np.float64]


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


def with_structures(tolerance: Sequence[Array], structures: Sequence[Structure]) -> list[Array]:
    """Return derivatives (rows, C, any) by the tolerances, and by structures behind them."""
    more = [structure.columns for structure in structures]
    return [np.concatenate(parts, axis=2) for parts in zip(tolerance, *more, strict=True)]


def normal_of(library: Library, weights: Weighting, blocks: NDArray[np.int64] | None = None) -> Normal:
    """Return the weighted sums over some blocks, all if None."""
    chosen = slice(None) if blocks is None else blocks
    return Normal(
        product=np.einsum("c,bckl->kl", weights.weight, library.moments.product[chosen]),
        gradient=np.einsum("c,bck->k", weights.weight, library.moments.gradient[chosen]),
        constant=-0.5 * float(library.moments.square[chosen].sum(axis=0) @ weights.weight),
    )


def labels(library: Library, model: Model) -> tuple[str, ...]:
    """Return what tells a set from others, whatever the model about which its candidates are linear."""
    found = []
    for candidate in (library.candidates[k] for k in model):
        rotor = not candidate.structure and EFFECTS.get(candidate.name).parameters[0].kind == "rotor"
        found.append(f"{candidate.name} {candidate.start[0]:.0f}" if rotor else candidate.name)
    return tuple(sorted(found))


def evidence_at(fit: Fit, neutral: Sequence[Array], weights: Weighting) -> tuple[float, Posterior]:
    """Return a constant and the posterior of a fitted set; with the constant evidences of one weighting are comparable."""
    free = fit.free_all
    product, gradient = normal_equations(fit, weights.weight)
    product, gradient = product[np.ix_(free, free)], gradient[free]
    away = np.zeros(fit.low.size)
    if fit.effects:
        away[: fit.num_effect_params] = (params_of(fit.point, fit.effects) - np.concatenate(neutral)) / scales(
            fit.effects
        )
    here = away[free]
    square = float((fit.moments.square.sum(axis=0) * weights.weight).sum())
    constant = -0.5 * square - float(gradient @ here) - 0.5 * float(here @ product @ here)
    count = fit.free_effects.size
    width = free.size
    low, high = (fit.low + away)[free], (fit.high + away)[free]
    low[count:], high[count:] = -np.inf, np.inf
    candidates = Candidates(
        columns=(np.arange(count),), tolerances=np.arange(count, width), low=low, high=high, exclusive=("all",)
    )
    normal = Normal(product=product, gradient=gradient + product @ here)
    return constant, posterior(candidates, normal, (0,))
