"""Rivals of single parameters: another effect that explains the flights in place of one parameter of a named effect.

A wrong torque ratio looks like a wrong inertia about one axis. So each parameter is put at neutral with another effect in
its place. Pairs that are probable in a model linear about the set are fitted, without prior penalty for the effect.
Letters: C channels.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import has_several_starts
from aerial_gym.sim2real.identify.evidence.fitting import ENOUGH, EffectSetFit, Fitter
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    effect_jacobian,
    is_continuous_parameter,
    parameter_scales,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import WEAK_PRIOR, StopRule
from aerial_gym.sim2real.identify.selection.candidate_view import FAR_BEHIND, occam_window
from aerial_gym.sim2real.predict.model_params import ModelParams


@dataclass(frozen=True, kw_only=True)
class ParameterRival:
    """Another effect in place of one parameter of a named effect."""

    effect: str
    parameter: str
    other: str
    params: dict[str, float]  # Parameters of the other effect
    log_odds: float  # Log evidence relative to the most probable set, divided by its overdispersion

    @property
    def finding(self) -> Finding:
        """Return the rival with its numbers."""
        values = {"parameter": self.parameter, "other": self.other, "params": self.params, "log_odds": self.log_odds}
        return Finding("parameter_tied", self.effect, values)

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {"parameter": self.parameter, "effect": self.other, "params": self.params, "log_odds": self.log_odds}


def rivals_of_parameters(
    fitter: Fitter, best: EffectSetFit, effects: Collection[str], names: Sequence[str]
) -> tuple[ParameterRival, ...]:
    """Return the rivals of parameters of some ``effects`` of the most probable set, among the confounders in ``names``."""
    window, matches = occam_window(best), []
    for effect, place, other in _rival_candidates(fitter, best, effects, names):
        values = best.params.effects[effect].copy()
        values[place] = fitter.neutral_of_effect(effect)[place]
        start = best.params.with_effect(effect, values).with_effect(other, fitter.neutral_of_effect(other))
        least = best.log_posterior - window - fitter.log_prior_cost_of_effect
        rule = StopRule(least=least, enough=ENOUGH * best.parameter_overdispersion)
        frame = {"frozen": frozenset({(effect, place)}), "rule": rule}
        fitted = fitter.fit((*best.effects, other), best.structures, start, **frame)
        odds = fitted.log_posterior + fitter.log_prior_cost_of_effect - best.log_posterior
        if odds > -window and fitted.support[other].is_supported:
            own = zip(EFFECTS.get(other).parameters, fitted.params.effects[other], strict=True)
            name, odds = EFFECTS.get(effect).parameters[place].name, odds / best.parameter_overdispersion
            params = {parameter.name: float(value) for parameter, value in own}
            matches.append(ParameterRival(effect=effect, parameter=name, other=other, params=params, log_odds=odds))
    return tuple(matches)


def _rival_candidates(
    fitter: Fitter, best: EffectSetFit, effects: Collection[str], names: Sequence[str]
) -> list[tuple[str, int, str]]:
    """Return triples of effect, index of its parameter and rival that are probable in the linear model."""
    predictor, params, window = fitter.predictor, best.params, occam_window(best)
    pairs = {
        name: _confounders_in_registry(fitter, best, name, names) if name in effects else [] for name in best.effects
    }
    rivals = list(dict.fromkeys(other for matches in pairs.values() for other in matches))
    if not rivals:
        return []
    base = predictor.predict(params)
    residuals = [m - p for m, p in zip(predictor.measured, base, strict=True)]
    parts = [effect_jacobian(predictor, params, best.effects, base)]
    for other in rivals:
        moved = params.with_effect(other, fitter.neutral_of_effect(other))
        parts.append(effect_jacobian(predictor, moved, (other,), base))
    owners = [(name, k) for name in best.effects for k in range(parameter_scales((name,)).size)]
    back = [owner for owner in owners if pairs[owner[0]] and is_continuous_parameter(*owner)]
    parts.extend(_change_by_one_parameter(fitter, params, base, *owner) for owner in back)
    moments = fitter.nuisance_sums(best.structures).moments_with_effects(
        residuals, [np.concatenate(own, axis=2) for own in zip(*parts, strict=True)]
    )
    ends = np.cumsum([part[0].shape[2] for part in parts])
    own, beside = np.arange(ends[0]), np.arange(ends[-1], moments.gradient.shape[2])
    columns = {other: np.arange(ends[k], ends[k + 1]) for k, other in enumerate(rivals)}
    gradient, product = moments.gradient.sum(axis=(0, 1)), moments.product.sum(axis=(0, 1))
    sums = _TotalSums(float(moments.square.sum()), gradient, product, num_effects=int(ends[-1]))
    here, matches = sums.negative_log_posterior(np.concatenate((own, beside))), []
    for number, (effect, place) in enumerate(back):
        shift = int(ends[len(rivals)]) + number
        rest = np.concatenate((own[[owner != (effect, place) for owner in owners]], beside))
        if sums.negative_log_posterior(rest, shift) - here < window:
            continue  # the flights do not show this parameter
        for other in pairs[effect]:
            if sums.negative_log_posterior(np.concatenate((rest, columns[other])), shift) - here < FAR_BEHIND * window:
                matches.append((effect, place, other))
    return matches


def _confounders_in_registry(fitter: Fitter, best: EffectSetFit, effect: str, names: Sequence[str]) -> list[str]:
    """Return the confounders that can replace one parameter of an effect; none if it has only one parameter."""
    if sum(is_continuous_parameter(effect, k) for k in range(parameter_scales((effect,)).size)) < 2:
        return []
    own = EFFECTS.get(effect).confused_with
    robot = fitter.predictor.robot
    confounders = [other for other in names if other in own or effect in EFFECTS.get(other).confused_with]
    return [other for other in confounders if other not in best.effects and not has_several_starts(other, robot)]


def _change_by_one_parameter(
    fitter: Fitter, params: ModelParams, base: list[Array], effect: str, place: int
) -> list[Array]:
    """Return the prediction minus that with one parameter at neutral, (rows, C, 1) for each flight."""
    values = params.effects[effect].copy()
    values[place] = fitter.neutral_of_effect(effect)[place]
    there = fitter.predictor.predict(params.with_effect(effect, values))
    return [(b - t)[..., None] for b, t in zip(base, there, strict=True)]


@dataclass(frozen=True)
class _TotalSums:
    """Normal equations over all flights, with the columns of effects first, then of tolerances and structures."""

    square: float
    gradient: Array
    product: Array
    num_effects: int

    def negative_log_posterior(self, columns: Indices, shift: int | None = None) -> float:
        """Return the negative log posterior of the best fit of some columns, with column ``shift`` added to the residual."""
        square, gradient = self.square, self.gradient
        if shift is not None:
            square = square + 2.0 * gradient[shift] + self.product[shift, shift]
            gradient = gradient + self.product[shift]
        precision = np.where(columns < self.num_effects, WEAK_PRIOR**-2, 1.0)
        inner = self.product[np.ix_(columns, columns)] + np.diag(precision)
        return 0.5 * float(square - gradient[columns] @ np.linalg.solve(inner, gradient[columns]))
