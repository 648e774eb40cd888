"""Posterior predictive distribution of the test residual: the part that the training flights do not determine.

A parameter that training does not excite keeps its prior variance. This holds for deviations within the tolerances, for
parameters of named effects, and for effects without a name yet. The test residual is ``r = J d + noise``. The parameter error
d is normal with the posterior covariance ``A^-1 = (sum w J J^T + P)^-1`` of the training flights. So the log density is
``-1/2 (r W r - h (A + B)^-1 h) - 1/2 log det(1 + A^-1 B)`` plus a constant that all sets share, with ``B = J W J`` and
``h = J W r``. Test flights can make a named effect doubtful, but never name one.
Letters: C channels, K parameters (those of effects in units of their scale, then the deviations in standard deviations).

Source: Box (1980), Sampling and Bayes' inference in scientific modelling and robustness, J. R. Statist. Soc. A 143
(predictive densities of data that were not used).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import Candidate, Library, build_library, linearise_candidates
from aerial_gym.sim2real.identify.candidates.nuisance import channels_with_common_offsets
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit
from aerial_gym.sim2real.identify.least_squares.box_minimum import minimise_in_bounds
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    effect_jacobian,
    is_continuous_parameter,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    WEAK_PRIOR,
    normal_equations_without_prior,
    prior_precision,
)
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import ratio_quantile

MANY = 1e9  # Degrees of freedom that stand for a known variance
PASSES = 3  # Iterations between the fit and the channel weights from its residual on the test flights


def largest_open_squares(
    test: Predictor, params: ModelParams, selection: SelectionResult, fitted: Flags | None = None
) -> tuple[Array, Array]:
    """Return the largest mean square of each channel that parameter errors may cause on test flights, (C,).

    The second array includes an offset of each test flight. Its standard deviation is that between training flights. Few
    flights estimate it poorly, so the limit uses their degrees of freedom and never exceeds that for offsets of ``most``.

    A larger mean square has the probability ``Criteria.significance``. Named parameters that training does not show have a
    standard deviation of their scale. Where training is predicted down to noise, the scatter of parameters between flights
    widens the covariance; elsewhere that scatter comes from missing physics and widens nothing.

    Args:
        fitted: Whether the training residual of each channel is only noise, (C,); None: in all channels.
    """
    fit = selection.fit
    predicted = test.predict(params)
    tolerance = tolerance_jacobian(test, params)
    jacobian = np.concatenate(effect_jacobian(test, params, fit.effects, predicted, beside=tolerance))
    precision, owners = prior_precision(fit), fit.parameter_owners
    precision[[k for k, owner in enumerate(owners) if owner in fit.frozen]] = 1.0
    chosen = np.array([k for k in range(precision.size) if k >= len(owners) or is_continuous_parameter(*owners[k])])
    product, _ = normal_equations_without_prior(fit, selection.weights.weight)
    covariance = np.linalg.inv((product + np.diag(precision))[np.ix_(chosen, chosen)])
    wider = np.ones(chosen.size)
    for place, std in zip(selection.spread.columns, selection.spread.std, strict=True):
        own = np.flatnonzero(chosen == place)
        wider[own] = np.maximum(1.0, std / np.sqrt(np.diag(covariance)[own]))
    columns = jacobian[:, :, chosen]
    mean_product = np.stack([own.T @ own for own in columns.swapaxes(0, 1)]) / columns.shape[0]
    rows = np.array([time.size for time in test.times])
    offset_channels, significance = selection.flight_offsets, selection.criteria.significance
    freedom = np.ones(len(test.channels)) * max(1, np.unique(fit.moments.flight).size - 1)
    for places in channels_with_common_offsets(test.channels).values():
        freedom[places] *= len(places)

    def with_offsets(size: Array, covariance: Array, freedom: ArrayLike) -> Array:
        """Return the sum of two limits of half the probability each: no larger sum is more probable (Bonferroni)."""
        each = size[:, None, None] ** 2 * np.diag(rows / rows.sum())
        offsets = quantile_of_squares(each, np.eye(rows.size), 0.5 * significance, freedom=freedom)
        own, alone = (quantile_of_squares(mean_product, covariance, share * significance) for share in (0.5, 1.0))
        return np.where(size > 0.0, own + offsets, alone)

    def limits(covariance: Array) -> tuple[Array, Array]:
        estimated = with_offsets(offset_channels.size, covariance, freedom)
        return (
            quantile_of_squares(mean_product, covariance, significance),
            np.minimum(estimated, with_offsets(offset_channels.most, covariance, MANY)),
        )

    by_scatter, by_noise = limits(covariance * np.outer(wider, wider)), limits(covariance)
    if fitted is None:
        return by_scatter
    return np.where(fitted, by_scatter[0], by_noise[0]), np.where(fitted, by_scatter[1], by_noise[1])


def quantile_of_squares(product: Array, covariance: Array, significance: float, *, freedom: ArrayLike = MANY) -> Array:
    """Return the upper quantile of ``d^T M d`` for normal d, which it exceeds with probability ``significance``, (C,).

    Args:
        product: A matrix M for each channel, (C, K, K).
        covariance: Covariance S of d, (K, K).
        freedom: Degrees of freedom from which the size of S was estimated, for all channels or for each, (C,).

    Source:
        Satterthwaite (1946), An approximate distribution of estimates of variance components, Biometrics Bulletin 2. The form
        is taken as a multiple of chi-square with the same mean ``tr(M S)`` and variance ``2 tr((M S)²)``. An estimated size is
        another such multiple, so their ratio has an F distribution.
    """
    spread = product @ covariance
    mean = np.maximum(np.einsum("ckk->c", spread), 1e-300)
    own = np.maximum(mean**2 / np.maximum(np.einsum("ckl,clk->c", spread, spread), 1e-300), 1.0)
    return mean * ratio_quantile(1.0 - significance, own, np.minimum(MANY, freedom))


@dataclass(frozen=True, kw_only=True)
class ResidualCriterion:
    """The unexplained channels of the test flights, and the residual that would count as explained."""

    remaining: Flags  # Whether each channel is unexplained, (C,)

    enough: Callable[[Array], Flags]
    """Whether an rms of each channel, (C,), is near the noise floor or within the tolerances, (C,)."""


def effects_left_open(
    train: Predictor, test: Predictor, models: tuple[ModelParams, ModelParams], selection: SelectionResult,
    asked: ResidualCriterion,
) -> tuple[str, ...]:  # fmt: skip
    """Return the effects that would explain the test residual and that training does not rule out, the best first.

    Each effect is fitted alone, together with the named effects and the tolerances.
    """
    declared, final = models[0], replace(models[1], deviation=None)
    names = [name for name in EFFECTS if EFFECTS.get(name).is_candidate_of_selection]
    skipped = [name for name in names if finding_on_untestable_effect(name, train.robot, train.flights, test.flights)]
    skipped += [*selection.surrogates, *set(names).difference(selection.looked_for)]
    known, weight, frozen = selection.effect_names, selection.weights.weight, selection.fit.frozen
    tangents = [linearise_candidates(flights, declared, final, known, skipped) for flights in (train, test)]
    both = set.intersection(*({one.key for one in part} for part in tangents))  # a load may swing over the top in one
    kept = [[one for one in part if one.key in both] for part in tangents]
    trained, tested = (
        build_library(flights, declared, final, known, weight, frozen=frozen, tangents=part, by_channel=True)
        for flights, part in zip((train, test), kept, strict=True)
    )
    return effects_sufficient_alone(trained, tested, selection.weights, asked, selection.criteria.significance)


def effects_sufficient_alone(
    seen: Library, tested: Library, weights: Weighting, asked: ResidualCriterion, significance: float
) -> tuple[str, ...]:
    """Return the effects whose joint fit agrees with training and explains every unexplained channel, the best first.

    ``A d = g`` are the normal equations of the training flights, ``B d = h`` those of the test flights. The joint fit is
    ``d = (A + B)^-1 (g + h)``. Training rules it out if the effect's part of ``d - A^-1 g`` is significant against the
    covariance ``A^-1``. The effect suffices if every unexplained channel falls near its noise floor. If named effects and
    tolerances suffice without it, it must need clearly smaller deviations. No parameter is taken from this fit.

    Args:
        seen: Candidates about the final model on the training flights.
        tested: The same on the test flights.
    """
    product, gradient = _sums_with_weights(seen, weights.weight)
    named = [candidate.columns for candidate in seen.candidates if candidate.named]
    beside = np.concatenate([*named, seen.tolerances]).astype(int)
    left: dict[str, float] = {}

    def information_and_gradient(columns: Indices) -> tuple[Array, Array]:
        """Return the information matrix A with its prior, and the gradient g, of some columns."""
        prior = np.where(np.isin(columns, seen.tolerances), 1.0, WEAK_PRIOR**-2)
        return product[np.ix_(columns, columns)] + np.diag(prior), gradient[columns]

    def suffices(squares: Array) -> bool:
        return bool(asked.enough(np.sqrt(squares))[asked.remaining].all())

    step, squares = _joint_step(*information_and_gradient(beside), tested, None, beside, weights)
    alone = _deviation_cost(step, seen) if suffices(squares) else np.inf
    for candidate in seen.candidates:
        if candidate.named or not candidate.columns.size:
            continue
        columns = np.concatenate((candidate.columns, beside))
        a, g = information_and_gradient(columns)
        step, squares = _joint_step(a, g, tested, candidate, columns, weights)
        spread, own = np.linalg.inv(a), candidate.columns.size
        away = (step - spread @ g)[:own]
        likely = away @ np.linalg.solve(spread[:own, :own], away) <= special.chdtri(own, significance)
        pays = (
            alone - _deviation_cost(step, seen) > LEAST_SCORE
        )  # else new values of named effects and tolerances suffice
        if likely and pays and suffices(squares):
            cost = float((weights.weight * squares)[asked.remaining].sum())
            left[candidate.name] = min(cost, left.get(candidate.name, np.inf))
    return tuple(sorted(left, key=lambda name: left[name]))


def _deviation_cost(step: Array, library: Library) -> float:
    """Return the negative log prior ``d² / 2`` of the deviations, the last entries of a step."""
    return 0.5 * float(np.square(step[step.size - library.tolerances.size :]).sum())


def _joint_step(
    a: Array, g: Array, tested: Library, candidate: Candidate | None, columns: Indices, weights: Weighting
) -> tuple[Array, Array]:
    """Return the joint step of all flights (``a``, ``g``: training), and the test flights' mean squares after it, (C,).

    The weight of a channel of the test flights is limited by its remaining mean square.
    """
    weight, whole = weights.weight, np.zeros(tested.moments.gradient.shape[2])
    high = np.full(columns.size, np.inf)
    low = -high
    if candidate is not None:  # its parameters come first
        low[: candidate.columns.size], high[: candidate.columns.size] = candidate.low, candidate.high
    rows, blocks = tested.moments.count.sum(), tested.moments.count.size
    for _ in range(PASSES):
        product, gradient = _sums_with_weights(tested, weight)
        joint, pull = a + product[np.ix_(columns, columns)], g + gradient[columns]
        step = minimise_in_bounds(joint, pull, low, high)
        whole[columns] = step
        squares = tested.moments.block_squares(np.tile(whole, (blocks, 1))).sum(axis=0) / rows
        squares = np.maximum(squares, 0.0)
        weight = weights.weight_below_limit(squares)
    return step, squares


def _sums_with_weights(library: Library, weight: Array) -> tuple[Array, Array]:
    moments = library.moments
    return np.einsum("c,bckl->kl", weight, moments.product), np.einsum("c,bck->k", weight, moments.gradient)


def channel_names(channels: Sequence[str], chosen: Flags) -> tuple[str, ...]:
    """Return the names of some channels."""
    return tuple(name for name, some in zip(channels, chosen, strict=True) if some)


def selection_with_test_odds(selection: SelectionResult, test: Predictor) -> SelectionResult:
    """Return the selection with the log odds that the test flights add to each rival of a named effect, at least 0."""
    rivals = {one.fitted.label: one.fitted for name in selection.effect_names for one in selection.effect_rivals(name)}
    if not rivals:
        return selection
    densities = log_densities(test, [selection.named, *rivals.values()], selection)
    gain = (densities[1:] - densities[0]) / selection.best.parameter_overdispersion
    return replace(selection, doubt=dict(zip(rivals, np.maximum(gain, 0.0).tolist(), strict=True)))


def notes_on_doubt(selection: SelectionResult) -> list[Finding]:
    """Return a note on each rival that is tied only because of the test flights."""
    return [
        Finding("doubt_by_test", name, {"other": rival.effect, "log_odds": rival.log_odds - rival.doubt})
        for name in selection.effect_names
        for rival in selection.effect_ties(name)
        if rival.is_clearly_less_probable_in_training
    ]


@dataclass(frozen=True)
class ResidualSums:
    """Sums over the rows of the test flights of a set's residual r and Jacobian J, and its precision in training."""

    square: Array  # ``r r``, (C,)
    gradient: Array  # ``J r``, (C, K)
    product: Array  # ``J J``, (C, K, K)
    precision: Array  # A, (K, K)

    def joint_step(self, weight: Array) -> Array:
        """Return the parameter step that fits training and test flights together, (K,)."""
        joint = self.precision + np.tensordot(weight, self.product, axes=1)
        return np.linalg.solve(joint, weight @ self.gradient)

    def squares_after_step(self, step: Array) -> Array:
        """Return the sum of squared residuals of each channel after a parameter step, (C,)."""
        return self.square - 2.0 * self.gradient @ step + np.einsum("k,ckl,l->c", step, self.product, step)

    def log_density(self, weight: Array) -> float:
        """Return the predictive log density of the test flights, without the constant shared by all sets."""
        step, seen = self.joint_step(weight), np.tensordot(weight, self.product, axes=1)
        surer = np.linalg.slogdet(self.precision + seen)[1] - np.linalg.slogdet(self.precision)[1]
        return -0.5 * float(weight @ self.square - (weight @ self.gradient) @ step + surer)


def log_densities(test: Predictor, fits: Sequence[EffectSetFit], selection: SelectionResult) -> Array:
    """Return the predictive log density of the test flights under each of M sets, up to a shared constant, (M,).

    The weight of a channel is limited by the smallest mean square that any set leaves in it.
    """
    weights, sums = selection.weights, [residual_sums(test, one, selection) for one in fits]
    rows, weight = sum(time.size for time in test.times), weights.weight
    for _ in range(PASSES):
        least = np.min([one.squares_after_step(one.joint_step(weight)) for one in sums], axis=0) / rows
        weight = weights.weight_below_limit(least)
    return np.array([one.log_density(weight) for one in sums])


def residual_sums(test: Predictor, fitted: EffectSetFit, selection: SelectionResult) -> ResidualSums:
    """Return the residual sums of a set on the test flights at its most probable model, without offsets of flights."""
    at, offsets = fitted.model_with_deviations, selection.flight_offsets
    predicted = test.predict(at)
    tolerance = tolerance_jacobian(test, at)
    columns = effect_jacobian(test, at, fitted.effects, predicted, beside=tolerance)
    owners = [(name, place) for name in fitted.effects for place in range(len(EFFECTS.get(name).parameters))]
    own = [k for k, owner in enumerate(owners) if is_continuous_parameter(*owner)]
    kept = np.array([*own, *range(len(owners), len(owners) + test.num_tolerances)])
    jacobian = np.concatenate([*offsets.remove_offsets(part[:, :, kept] for part in columns)])
    left = np.concatenate([*offsets.remove_offsets(m - p for m, p in zip(test.measured, predicted, strict=True))])
    gradient = np.einsum("rck,rc->ck", jacobian, left)
    product = np.stack([jacobian[:, c].T @ jacobian[:, c] for c in range(left.shape[1])])
    precision = np.linalg.inv(fitted.parameters.covariance[: kept.size, : kept.size])
    return ResidualSums(np.square(left).sum(axis=0), gradient, product, precision)
