"""What a single parameter of a named effect may as well be: another effect, beside the rest of the first.

A torque ratio makes what an inertia about one axis makes, and the flights show the other two. A swap of whole effects does not
see that. Each parameter is put back to neutral with another effect in its place: first in the model that is linear about the
set, without bounds, as a factor on an inertia and one on a torque are the same to first order only in direction; what may
come near is fitted. What is compared is evidence without the price of a name, for a parameter is exchanged for a parameter.

Letters: C channels.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import has_starts
from aerial_gym.sim2real.identify.evidence.fitting import ENOUGH, Compared, Fitted, Fitter
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import WEAK_PRIOR
from aerial_gym.sim2real.identify.least_squares.parameters import is_number, scales
from aerial_gym.sim2real.identify.selection.view import FAR_BEHIND, occam_window
from aerial_gym.sim2real.predict.model_params import ModelParams


@dataclass(frozen=True, kw_only=True)
class RivalInPart:
    """Another effect in the place of one parameter of a named one."""

    effect: str
    parameter: str
    other: str

    params: dict[str, float]
    """Of the other effect."""

    log_odds: float
    """Log evidence over that of the most probable set, as far as flights agree."""

    @property
    def finding(self) -> Finding:
        """Return the rival with its numbers."""
        values = {"parameter": self.parameter, "other": self.other, "params": self.params, "log_odds": self.log_odds}
        return Finding("parameter_tied", self.effect, values)

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {
            "parameter": self.parameter,
            "effect": self.other,
            "params": self.params,
            "log_odds": self.log_odds,
        }


def rivals_in_part(
    fitter: Fitter, best: Fitted, effects: Collection[str], names: Sequence[str]
) -> tuple[RivalInPart, ...]:
    """Return what single parameters of some effects of a set may as well be, beside the structures of that set.

    Args:
        fitter: Fits sets about the set.
        best: The most probable set.
        effects: Those of it whose parameters are asked for.
        names: Effects that the flights can show: each that an effect can be confused with is tried.
    """
    window, found = occam_window(best), []
    for effect, place, other in _promising(fitter, best, effects, names):
        values = best.params.effects[effect].copy()
        values[place] = fitter.neutral(effect)[place]
        start = best.params.with_effect(effect, values).with_effect(other, fitter.neutral(other))
        least = best.log_posterior - window - fitter.log_names
        fitted = fitter.fit(
            (*best.effects, other),
            best.structures,
            start,
            frozen=frozenset({(effect, place)}),
            compared=Compared(least=least, enough=ENOUGH * best.overdispersion),
        )
        odds = fitted.log_posterior + fitter.log_names - best.log_posterior
        if odds > -window and fitted.support[other].holds:
            own = zip(EFFECTS.get(other).parameters, fitted.params.effects[other], strict=True)
            found.append(
                RivalInPart(
                    effect=effect,
                    parameter=EFFECTS.get(effect).parameters[place].name,
                    other=other,
                    params={parameter.name: float(value) for parameter, value in own},
                    log_odds=odds / best.overdispersion,
                )
            )
    return tuple(found)


def _promising(
    fitter: Fitter, best: Fitted, effects: Collection[str], names: Sequence[str]
) -> list[tuple[str, int, str]]:
    """Return effect, place of a parameter and other effect, where the linear model may come near the set."""
    predictor, params, window = fitter.predictor, best.params, occam_window(best)
    pairs = {name: _confused(fitter, best, name, names) if name in effects else [] for name in best.effects}
    others = list(dict.fromkeys(other for found in pairs.values() for other in found))
    if not others:
        return []
    base = predictor.predict(params)
    residuals = [m - p for m, p in zip(predictor.measured, base, strict=True)]
    parts = [effect_jacobian(predictor, params, best.effects, base)]
    for other in others:
        parts.append(effect_jacobian(predictor, params.with_effect(other, fitter.neutral(other)), (other,), base))
    owners = [(name, k) for name in best.effects for k in range(scales((name,)).size)]
    back = [owner for owner in owners if pairs[owner[0]] and is_number(*owner)]
    parts.extend(_changes(fitter, params, base, *owner) for owner in back)
    moments = fitter.beside(best.structures).moments(
        residuals, [np.concatenate(own, axis=2) for own in zip(*parts, strict=True)]
    )
    ends = np.cumsum([part[0].shape[2] for part in parts])
    own, beside = np.arange(ends[0]), np.arange(ends[-1], moments.gradient.shape[2])
    columns = {other: np.arange(ends[k], ends[k + 1]) for k, other in enumerate(others)}
    sums = _Sums(
        float(moments.square.sum()),
        moments.gradient.sum(axis=(0, 1)),
        moments.product.sum(axis=(0, 1)),
        num_effects=int(ends[-1]),
    )
    here, found = sums.left(np.concatenate((own, beside))), []
    for number, (effect, place) in enumerate(back):
        shift = int(ends[len(others)]) + number
        rest = np.concatenate((own[[owner != (effect, place) for owner in owners]], beside))
        if sums.left(rest, shift) - here < window:
            continue  # it is not shown
        for other in pairs[effect]:
            if sums.left(np.concatenate((rest, columns[other])), shift) - here < FAR_BEHIND * window:
                found.append((effect, place, other))
    return found


def _confused(fitter: Fitter, best: Fitted, effect: str, names: Sequence[str]) -> list[str]:
    """Return the effects that may stand in the place of one parameter of an effect that has several."""
    if sum(is_number(effect, k) for k in range(scales((effect,)).size)) < 2:
        return []
    own = EFFECTS.get(effect).confused_with
    return [
        other
        for other in names
        if other not in best.effects
        and (other in own or effect in EFFECTS.get(other).confused_with)
        and not has_starts(other, fitter.predictor.robot)
    ]


def _changes(fitter: Fitter, params: ModelParams, base: list[Array], effect: str, place: int) -> list[Array]:
    """Return what goes from the prediction when a parameter goes back to neutral, (rows, C, 1) of each flight."""
    values = params.effects[effect].copy()
    values[place] = fitter.neutral(effect)[place]
    there = fitter.predictor.predict(params.with_effect(effect, values))
    return [(b - t)[..., None] for b, t in zip(base, there, strict=True)]


@dataclass(frozen=True)
class _Sums:
    """Sums over all flights of a residual and of columns: of effects, and of tolerances and structures behind them."""

    square: float
    gradient: Array
    product: Array
    num_effects: int

    def left(self, columns: Indices, shift: int | None = None) -> float:
        """Return the negative log likelihood that some columns leave of the residual, with one column added to it."""
        square, gradient = self.square, self.gradient
        if shift is not None:
            square = square + 2.0 * gradient[shift] + self.product[shift, shift]
            gradient = gradient + self.product[shift]
        precision = np.where(columns < self.num_effects, WEAK_PRIOR**-2, 1.0)
        inner = self.product[np.ix_(columns, columns)] + np.diag(precision)
        return 0.5 * float(square - gradient[columns] @ np.linalg.solve(inner, gradient[columns]))
