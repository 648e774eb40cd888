"""Ties of declared values: other combinations of them that give the flights the same likelihood as the named effects.

Flights show masses, inertias and thrusts as ratios only, so the likelihood has null directions: the values move, the
predictions stay. Ratios are straight lines in the logarithms of the values. In these, the log likelihood is quadratic about the
named effects, and each combination of effects at their declared values costs a loss. The loss is relative to the named effects
beside those in their place, so that what the latter explain further makes no tie. Small losses are confirmed by the full model.
Letters: K parameters of effects.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import RotorSensorEffect, VehicleEffect
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import has_several_starts, law_relatives, neutral_params
from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    effect_jacobian,
    is_continuous_parameter,
    parameter_row,
    parameter_scales,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    WEAK_PRIOR,
    ModelFit,
    fit_effects,
    least_cost_over_nuisances,
)
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import are_scaled_by_thrust

SMALL = 3  # Number of effects in place of the named ones up to which all ties are listed; beyond it, the simplest ones


@dataclass(frozen=True, kw_only=True)
class ValueTie:
    """Effects on declared values that explain the flights in place of some named effects."""

    replaced: tuple[str, ...]  # Named effects whose values would be as declared
    params: dict[str, dict[str, float]]  # Parameters of the effects in their place
    loss: float  # Log likelihood that the flights lose without the replaced effects, over the overdispersion
    undetermined: tuple[
        str, ...
    ] = ()  # Effects that these logs leave open, so that one more of them is no further cause

    @property
    def causes(self) -> tuple[str, ...]:
        """Return the effects in place of the replaced ones, without undetermined ones beside others."""
        return tuple(name for name in self.params if name not in self.undetermined) or tuple(self.params)

    @property
    def is_as_simple(self) -> bool:
        """Return whether it needs no more causes than it replaces."""
        return len(self.causes) <= len(self.replaced)

    @property
    def finding(self) -> Finding:
        """Return the tie with its numbers."""
        values = {"others": [{"effect": name, "params": own} for name, own in self.params.items()], "loss": self.loss}
        return Finding("values_tied", self.replaced[0], {"replaced": list(self.replaced), **values})

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {"replaced": list(self.replaced), "params": self.params, "log_likelihood_loss": self.loss}


def find_undetermined_effects(flights: Sequence[Flight]) -> tuple[str, ...]:
    """Return the thrust coefficient if the mean measured thrust scales the commands of all flights, else nothing.

    The scale assumes the declared mass and thrust, so another mass comes with another thrust.
    """
    return ("thrust_coefficient",) if are_scaled_by_thrust(flights) else ()


def find_value_ties(
    predictor: Predictor, declared: ModelParams, fit: ModelFit, beside: NuisanceSums, names: Sequence[str], *,
    window: float, overdispersion: float,
) -> tuple[ValueTie, ...]:  # fmt: skip
    """Return the ties whose loss of log likelihood is below ``window``, none of which contains another.

    ``names`` are the effects that may act, beside undetermined ones; ``beside`` holds the tolerances, with the channel weights.
    """
    undetermined = find_undetermined_effects(predictor.flights)
    names = list(dict.fromkeys((*names, *undetermined)))
    own = [
        name for name in fit.effects if _is_on_declared_value(name, predictor, declared) or _scales_rotor_speeds(name)
    ]
    relatives = {name for one in fit.effects for name in (one, *law_relatives(one))}
    new = [name for name in names if name not in relatives and _is_on_declared_value(name, predictor, declared)]
    if not own or not new:
        return ()
    surface = _LikelihoodSurface(predictor, declared, fit, beside, (*fit.effects, *new))
    results, refused = list[ValueTie](), list[tuple[tuple[str, ...], tuple[str, ...]]]()
    for replaced, more in _combinations(own, new, surface, window):
        sizes = [len(one.params) for one in results if one.replaced == replaced]
        if len(more) > max(SMALL, min(sizes, default=len(new))):
            continue
        if len(more) > SMALL and any(one == replaced and set(other) <= set(more) for one, other in refused):
            continue
        if any(set(replaced) <= set(one.replaced) and set(one.params) <= set(more) for one in results):
            continue
        if surface.loss(replaced, more) >= window:
            continue
        if (tied := surface.confirm(replaced, more, window)) is None:
            refused.append((replaced, more))
        else:
            params, loss = tied
            values = {name: dict(zip(_names(name), params.effects[name].tolist(), strict=True)) for name in more}
            results.append(
                ValueTie(replaced=replaced, params=values, loss=loss / overdispersion, undetermined=undetermined)
            )
    return tuple(results)


def _combinations(
    own: Sequence[str], new: Sequence[str], surface: "_LikelihoodSurface", window: float
) -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Yield the named effects to replace, most first, with the effects in their place, fewest first.

    More than ``SMALL`` of them are tried only if all together make the loss small.
    """
    subsets = [list(combinations(own, size)) for size in range(len(own), 0, -1)]
    for replaced in chain(*subsets):
        most = len(new) if surface.loss(replaced, new) < window else min(SMALL, len(new))
        for size in range(1, most + 1):
            yield from ((replaced, more) for more in combinations(new, size))


def _is_on_declared_value(name: str, predictor: Predictor, declared: ModelParams) -> bool:
    """Return whether an effect changes numbers of the robot file, for all rotors alike."""
    effect = EFFECTS.get(name)
    on_file = isinstance(effect, VehicleEffect) or (name in declared.effects and not effect.remembers)
    return on_file and not has_several_starts(name, predictor.robot)


def _scales_rotor_speeds(name: str) -> bool:
    """Return whether an effect scales measured rotor speeds, which act as a thrust and a rotor inertia of another size."""
    return isinstance(EFFECTS.get(name), RotorSensorEffect)


def _names(effect: str) -> list[str]:
    return [parameter.name for parameter in EFFECTS.get(effect).parameters]


class _LikelihoodSurface:
    """The log likelihood about the named effects, quadratic in the coordinates of all effects on declared values.

    The coordinate of a value with positive declaration is its logarithm, that of others is the value per scale.
    """

    def __init__(
        self, predictor: Predictor, declared: ModelParams, fit: ModelFit, beside: NuisanceSums, effects: tuple[str, ...]
    ) -> None:
        self.predictor, self.effects, self.fit, self.beside = predictor, effects, fit, beside
        self.levels = dict[tuple[str, ...], float]()
        robot = predictor.robot
        self.neutral = {name: neutral_params(name, declared, robot) for name in effects}
        self.params = fit.params
        for name in effects[len(fit.effects) :]:
            self.params = self.params.with_effect(name, self.neutral[name])
        self.owners = [(name, place) for name in effects for place in range(len(_names(name)))]
        self.base = np.array([robot.body.mass if name == "payload_mass" else 0.0 for name, _ in self.owners])
        self.here = parameter_row(self.params, effects) + self.base
        self.there = np.concatenate([self.neutral[name] for name in effects]) + self.base
        self.scale = parameter_scales(effects)
        self.logarithmic = (self.here > 0.0) & (self.there > 0.0)
        product, gradient = self._equations()
        slope = np.where(self.logarithmic, self.here / self.scale, 1.0)
        self.product, self.gradient = slope * product * slope[:, None], slope * gradient

    def _equations(self) -> tuple[Array, Array]:
        """Return the normal equations per scale (K, K) and (K,), with the tolerances integrated out."""
        predictor, count = self.predictor, self.here.size
        predicted = predictor.predict(self.params)
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        moments = self.beside.moments_with_effects(
            residuals, effect_jacobian(predictor, self.params, self.effects, predicted)
        )
        product, gradient = moments.product.sum(axis=(0, 1)), moments.gradient.sum(axis=(0, 1))
        across = product[:count, count:]
        inner = np.linalg.inv(product[count:, count:] + np.eye(len(product) - count))
        prior = np.eye(count) * WEAK_PRIOR**-2
        return (
            product[:count, :count] + prior - across @ inner @ across.T,
            gradient[:count] - across @ inner @ gradient[count:],
        )

    def _columns(self, effects: Sequence[str]) -> Indices:
        """Return the free coordinates of some effects."""
        places = enumerate(self.owners)
        return np.array(
            [
                k
                for k, owner in places
                if owner[0] in effects and owner not in self.fit.frozen and is_continuous_parameter(*owner)
            ],
            dtype=int,
        )

    def _cost(self, step: Array, free: Indices) -> tuple[float, Array]:
        """Return the least negative log likelihood over the free coordinates from a fixed step (K,), and the whole step."""
        step = step.copy()
        if free.size:
            inner = self.product[np.ix_(free, free)]
            step[free] = np.linalg.lstsq(inner, (self.gradient - self.product @ step)[free], rcond=None)[0]
        return 0.5 * float(step @ self.product @ step) - float(self.gradient @ step), step

    def loss(self, replaced: Sequence[str], more: Sequence[str]) -> float:
        """Return the loss of log likelihood without some effects, beside ``more`` ones."""
        return self._cost_of_replacement(replaced, more)[0] - self._level(tuple(more))

    def _level(self, more: tuple[str, ...]) -> float:
        """Return the least negative log likelihood of the named effects beside ``more`` ones."""
        if more not in self.levels:
            self.levels[more] = self._cost(np.zeros(self.here.size), self._columns([*self.fit.effects, *more]))[0]
        return self.levels[more]

    def _cost_of_replacement(self, replaced: Sequence[str], more: Sequence[str]) -> tuple[float, Array]:
        """Return the least negative log likelihood with effects replaced by others, and the step of all coordinates (K,)."""
        back, step = self._columns(replaced), np.zeros(self.here.size)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(self.logarithmic, np.log(self.there / self.here), (self.there - self.here) / self.scale)
        step[back] = ratio[back]
        kept = [name for name in self.fit.effects if name not in replaced]
        return self._cost(step, self._columns([*kept, *more]))

    def confirm(self, replaced: Sequence[str], more: Sequence[str], window: float) -> tuple[ModelParams, float] | None:
        """Return the model of a tie and its loss by the full model; None if that is not below ``window``."""
        step, gain = self._cost_of_replacement(replaced, more)[1], self._level(()) - self._level(tuple(more))
        ahead = np.where(self.logarithmic, self.here * np.exp(step * self.logarithmic), self.here + self.scale * step)
        values, params = ahead - self.base, self.params
        if not self._are_possible(values):
            return None
        for name in self.effects:
            own: Flags = np.array([owner == name for owner, _ in self.owners])
            params = params.with_effect(name, self.neutral[name] if name in replaced else values[own])
        effects = (*(name for name in self.fit.effects if name not in replaced), *more)
        if (loss := self._full_loss(params) + gain) >= window:
            params = fit_effects(self.predictor, effects, params, self.beside, frozen=self.fit.frozen)[0].params
            loss = self._full_loss(params) + gain
        return (params, loss) if loss < window else None

    def _are_possible(self, values: Array) -> bool:
        """Return whether each value (K,) is within the bounds of its parameter."""
        bounds = [bound for name in self.effects for bound in EFFECTS.get(name).bounds(self.predictor.robot)]
        return all(low <= value <= high for value, (low, high) in zip(values.tolist(), bounds, strict=True))

    def _full_loss(self, params: ModelParams) -> float:
        """Return the loss of log likelihood of a model against the named effects."""
        costs = [least_cost_over_nuisances(self.beside, self.predictor.residuals(one)) for one in (params, self.params)]
        return 0.5 * (costs[0] - costs[1])
