"""What training flights leave open on the test flights: the posterior predictive of a residual.

What training does not excite keeps its prior variance: a deviation within the tolerances, a parameter of a named effect, an
effect that has no name yet. ``r = J d + noise`` on the test flights, with d normal of the posterior covariance
``(sum w J J^T + P)^-1`` of the training flights.
Letters: C channels, K parameters (those of effects in units of their scale, then the tolerances in deviations).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.identify.candidates.library import Candidate, Library, build_library
from aerial_gym.sim2real.identify.candidates.testable import lacks
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian, tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import WEAK_PRIOR, normal_equations, prior_precision
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.least_squares.parameters import is_number
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import ratio_quantile

MANY = 1e9
"""Degrees of freedom of a variance that is known."""

PASSES = 3
"""Of weighing the test flights by what is left of them."""


def left_open(
    test: Predictor, params: ModelParams, selection: SelectionResult, fitted: Flags | None = None
) -> tuple[Array, Array]:
    """Return the largest mean square of each channel that tolerances and named effects may leave on test flights, (C,).

    And the same with the offsets of test flights, which are as large as training flights have them of their own: the standard
    deviation of a few flights is not much of a number, they may be alike by chance, but none is larger than ``most``.

    Larger ones have the probability ``Criteria.significance``. Parameters of named effects that training does not show have a
    standard deviation of their scale. Where training flights are predicted down to noise, parameters that scatter between
    flights are no surer than their intervals; where not, it is what the model lacks that scatters, which leaves nothing open.

    Args:
        test: Test flights.
        params: The final model.
        selection: With its linearisation on the training flights.
        fitted: Whether noise is all that is left of each channel of the training flights, (C,); None: of all.
    """
    fit = selection.final.fit
    predicted = test.predict(params)
    tolerance = tolerance_jacobian(test, params)
    jacobian = np.concatenate(effect_jacobian(test, params, fit.effects, predicted, beside=tolerance))
    precision = prior_precision(fit)
    for place, owner in enumerate(fit.owners):
        if owner in fit.frozen:
            precision[place] = 1.0
    chosen = np.array(
        [place for place in range(precision.size) if place >= len(fit.owners) or is_number(*fit.owners[place])]
    )
    product, _ = normal_equations(fit, selection.weights.weight)
    covariance = np.linalg.inv((product + np.diag(precision))[np.ix_(chosen, chosen)])
    wider = np.ones(chosen.size)
    for place, std in zip(selection.final.spread.columns, selection.final.spread.std, strict=True):
        own = np.flatnonzero(chosen == place)
        wider[own] = np.maximum(1.0, std / np.sqrt(np.diag(covariance)[own]))
    columns = jacobian[:, :, chosen]
    mean_product = np.einsum("rck,rcl->ckl", columns, columns) / columns.shape[0]
    rows = np.array([time.size for time in test.times])
    found, significance = selection.own_offsets, selection.criteria.significance
    flights = np.unique(fit.moments.flight).size

    def with_offsets(size: Array, covariance: Array, freedom: float) -> Array:
        offsets = size[:, None, None] ** 2 * np.diag(rows / rows.sum())
        products = np.stack([beside(one, other) for one, other in zip(mean_product, offsets, strict=True)])
        whole = beside(covariance, np.eye(rows.size))
        return quantile_of_squares(products, whole, significance, estimated=rows.size, freedom=freedom)

    def limits(covariance: Array) -> tuple[Array, Array]:
        estimated = with_offsets(found.size, covariance, max(1, flights - 1))
        return (
            quantile_of_squares(mean_product, covariance, significance),
            np.minimum(estimated, with_offsets(found.most, covariance, MANY)),
        )

    by_scatter, by_noise = limits(covariance * np.outer(wider, wider)), limits(covariance)
    if fitted is None:
        return by_scatter
    return np.where(fitted, by_scatter[0], by_noise[0]), np.where(fitted, by_scatter[1], by_noise[1])


def beside(one: Array, other: Array) -> Array:
    """Return two square matrices as one, with nothing between them."""
    across = np.zeros((len(one), len(other)))
    return np.block([[one, across], [across.T, other]])


def quantile_of_squares(
    product: Array, covariance: Array, significance: float, *, estimated: int = 0, freedom: float = MANY
) -> Array:
    """Return what ``d^T M d`` exceeds with a probability, for each M of ``product`` (C, K, K) and normal d, (C,).

    Args:
        product: M.
        covariance: Of d, (K, K).
        significance: The probability.
        estimated: Of how many of d, the last ones, the size is itself estimated.
        freedom: With how many degrees of freedom.

    Source:
        Satterthwaite (1946), An approximate distribution of estimates of variance components, Biometrics Bulletin 2: as a
        multiple of chi-square with the same mean and variance, ``tr(M S)`` and ``2 tr((M S)²)``; and what is put in the place
        of ``tr(M S)`` as another, which together are distributed as F.
    """
    spread = product @ covariance
    means = np.einsum("ckk->ck", spread)
    mean = np.maximum(means.sum(axis=1), 1e-300)
    own = np.maximum(mean**2 / np.maximum(np.einsum("ckl,clk->c", spread, spread), 1e-300), 1.0)
    share = means[:, means.shape[1] - estimated :].sum(axis=1) / mean
    return mean * ratio_quantile(1.0 - significance, own, np.minimum(MANY, freedom / np.maximum(share, 1e-9) ** 2))


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What remains on the test flights."""

    remaining: Flags
    """In which channels, (C,)."""

    enough: Callable[[Array], Flags]
    """Whether an rms of each channel, (C,), is near the noise floor or within the tolerances, (C,)."""


def open_effects(
    train: Predictor,
    test: Predictor,
    models: tuple[ModelParams, ModelParams],
    selection: SelectionResult,
    asked: Asked,
) -> tuple[str, ...]:
    """Return the effects that would make what remains and that training flights do not rule out, the best first.

    Each is taken alone, beside the named ones and the tolerances.

    Args:
        train: Training flights.
        test: Test flights.
        models: The declared and the final one.
        selection: With what is accepted.
        asked: What remains.
    """
    declared, final = models
    names = [name for name in EFFECTS if EFFECTS.get(name).is_selectable]
    skipped = [name for name in names if lacks(name, train.robot, train.flights, test.flights)]
    skipped += [*selection.surrogates, *set(names).difference(selection.looked_for)]
    frozen = selection.final.fit.frozen
    libraries = [
        build_library(
            flights,
            declared,
            final,
            selection.accepted,
            selection.weights.weight,
            frozen=frozen,
            skipped=skipped,
            by_channel=True,
        )
        for flights in (train, test)
    ]
    return covering(libraries[0], libraries[1], selection.weights, asked, selection.criteria.significance)


def covering(seen: Library, tested: Library, weights: Weighting, asked: Asked, significance: float) -> tuple[str, ...]:
    """Return the effects that all flights together would put where training does not rule them out, and that then suffice.

    With ``A d = g`` of the training flights and ``B, h`` of the test flights, ``d = (A + B)^-1 (g + h)`` is ruled out if the
    effect's part of ``d - A^-1 g`` is larger than chance makes it, with its covariance ``A^-1``. It suffices if it brings every
    channel in which something remains near its floor. Where other values of named effects and tolerances would do,
    it must make clearly smaller deviations do. No parameter is taken from this: it says what the test flights ask for.

    Args:
        seen: About the final model on the training flights.
        tested: The same on the test flights.
        weights: What a row of each channel counts.
        asked: What remains.
        significance: Probability with which chance would put it as far.
    """
    product, gradient = _sums(seen, weights.weight)
    named = [candidate.columns for candidate in seen.candidates if candidate.named]
    beside = np.concatenate([*named, seen.tolerances]).astype(int)
    left: dict[str, float] = {}

    def learned(columns: Indices) -> tuple[Array, Array]:
        """Return A and g of some columns."""
        prior = np.where(np.isin(columns, seen.tolerances), 1.0, WEAK_PRIOR**-2)
        return product[np.ix_(columns, columns)] + np.diag(prior), gradient[columns]

    def suffices(squares: Array) -> bool:
        return bool(asked.enough(np.sqrt(squares))[asked.remaining].all())

    step, squares = _of_all_flights(*learned(beside), tested, None, beside, weights)
    alone = _cost(step, seen) if suffices(squares) else np.inf
    for candidate in seen.candidates:
        if candidate.named or not candidate.columns.size:
            continue
        columns = np.concatenate((candidate.columns, beside))
        a, g = learned(columns)
        step, squares = _of_all_flights(a, g, tested, candidate, columns, weights)
        spread, own = np.linalg.inv(a), candidate.columns.size
        away = (step - spread @ g)[:own]
        likely = away @ np.linalg.solve(spread[:own, :own], away) <= special.chdtri(own, significance)
        pays = alone - _cost(step, seen) > LEAST_SCORE  # else other values of what has a name already would do
        if likely and pays and suffices(squares):
            cost = float((weights.weight * squares)[asked.remaining].sum())
            left[candidate.name] = min(cost, left.get(candidate.name, np.inf))
    return tuple(sorted(left, key=lambda name: left[name]))


def _cost(step: Array, library: Library) -> float:
    """Return what the deviations at the end of a step cost in log likelihood."""
    return 0.5 * float(np.square(step[step.size - library.tolerances.size :]).sum())


def _of_all_flights(
    a: Array, g: Array, tested: Library, candidate: Candidate | None, columns: Indices, weights: Weighting
) -> tuple[Array, Array]:
    """Return the step that all flights ask for (``a``, ``g``: training), and what mean squares it leaves of the tested, (C,).

    A channel of the test flights weighs no more than what is left of it allows.
    """
    weight, whole = weights.weight, np.zeros(tested.moments.gradient.shape[2])
    rows, blocks = tested.moments.count.sum(), tested.moments.count.size
    for _ in range(PASSES):
        product, gradient = _sums(tested, weight)
        joint, pull = a + product[np.ix_(columns, columns)], g + gradient[columns]
        step = np.linalg.solve(joint, pull) if candidate is None else _within(joint, pull, candidate)
        whole[columns] = step
        squares = tested.moments.squares_after(np.tile(whole, (blocks, 1))).sum(axis=0) / rows
        squares = np.maximum(squares, 0.0)
        weight = weights.where_left(squares)
    return step, squares


def _sums(library: Library, weight: Array) -> tuple[Array, Array]:
    moments = library.moments
    return np.einsum("c,bckl->kl", weight, moments.product), np.einsum("c,bck->k", weight, moments.gradient)


def _within(a: Array, g: Array, candidate: Candidate) -> Array:
    """Return the solution of ``a d = g`` whose first parameters, those of a candidate, are held at bounds that they pass."""
    others = np.full(g.size - candidate.columns.size, np.inf)
    low, high = np.append(candidate.low, -others), np.append(candidate.high, others)
    step, free = np.linalg.solve(a, g), np.ones(g.size, dtype=bool)
    for _ in range(candidate.columns.size):
        beyond = (step < low) | (step > high)
        if not beyond.any():
            break
        free &= ~beyond
        step = np.clip(step, low, high)
        step[free] = np.linalg.solve(a[np.ix_(free, free)], g[free] - a[np.ix_(free, ~free)] @ step[~free])
    return step


def names_of(channels: Sequence[str], chosen: Flags) -> tuple[str, ...]:
    """Return the names of some channels."""
    return tuple(name for name, some in zip(channels, chosen, strict=True) if some)
