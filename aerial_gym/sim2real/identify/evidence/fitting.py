"""Nonlinear fits of sets of effects, and their evidence.

Letters: N tolerances.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.candidates.library import Library, has_rotor, has_starts, neutral_of
from aerial_gym.sim2real.identify.candidates.nuisance import Nuisance, offsets_of
from aerial_gym.sim2real.identify.candidates.testable import at_bounds
from aerial_gym.sim2real.identify.evidence.guard import Support, parts_of_a_flight, supports_of_fit
from aerial_gym.sim2real.identify.evidence.laplace import Model, Posterior, posterior
from aerial_gym.sim2real.identify.evidence.linear import linear_about
from aerial_gym.sim2real.identify.evidence.search import Sets
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    Derivatives,
    effect_jacobian,
    single,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import NOTHING_LEFT, Fit, Frozen, Goal, fit_effects
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.least_squares.parameters import bounds_of, is_number, scales
from aerial_gym.sim2real.identify.least_squares.weighted import Beside, Part
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

Label = tuple[str, ...]
"""Sorted names of a set's effects, with rotor number, and structures."""

BROAD = 3
"""Number of sets of equal size from which effects are removed."""

KEPT = 4
"""Number of fitted sets whose derivatives are cached."""

KEPT_BESIDE = 2
"""Number of cached sums of nuisance columns."""

ENOUGH = 2.0
"""Log likelihood, times the best set's overdispersion, that a comparison fit may leave to its linear model."""

NOTHING = Posterior(
    columns=np.zeros(0, dtype=np.int64),
    step=np.zeros(0),
    covariance=np.zeros((0, 0)),
    log_evidence=-np.inf,
    log_likelihood=-np.inf,
)
"""Posterior of a fit whose prediction is not finite."""


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Stopping rule of a fit that is only compared with the best set and needs no exact parameters."""

    least: float
    """Log posterior that the set, or a subset, must be able to reach; otherwise the fit stops."""

    enough: float
    """Log likelihood that the fit may leave to its linear model."""


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """A fitted set of effects and structures."""

    effects: tuple[str, ...]
    structures: tuple[Nuisance, ...]
    params: ModelParams
    log_posterior: float
    """Log evidence plus log prior, up to a constant common to all sets with equal weights; minus infinity for a prediction
    that is not finite."""

    parameters: Posterior
    """Posterior of effects, tolerances and structures other than flight offsets, in this order."""

    support: dict[str, Support]
    """Statistical support of each effect."""

    most: float = np.inf
    """Upper limit of the log posterior of this set and its subsets with the same structures: its own value, plus the possible
    further gain of the fit and the evidence against effects."""

    deviation: Array = field(default_factory=lambda: np.zeros(0))
    """Most probable deviations in standard deviations, (N,)."""

    @property
    def holds(self) -> bool:
        """Return whether every effect of this fit is more probable than not (guard.py)."""
        return np.isfinite(self.log_posterior) and all(one.holds for one in self.support.values())

    @property
    def overdispersion(self) -> float:
        """Return the parameters' variance between flights over that from noise, at least 1."""
        found = [one.size * one.overdispersion for one in self.support.values()]
        return max(1.0, sum(found) / max(1, sum(one.size for one in self.support.values())))

    @property
    def own(self) -> tuple[Nuisance, ...]:
        """Return the structures that are flight offsets."""
        return tuple(structure for structure in self.structures if structure.of_flights)

    @property
    def bare(self) -> bool:
        """Return whether there are no structures but flight offsets, as required for a robot file."""
        return self.own == self.structures

    @property
    def within(self) -> ModelParams:
        """Return the model with its most probable deviations."""
        return replace(self.params, deviation=self.deviation)

    @property
    def label(self) -> Label:
        """Return the label of the set."""
        return label_of(
            [(name, self.params.effects[name]) for name in self.effects],
            [structure.name for structure in self.structures],
        )


class Fitter:
    """Fits sets of effects, with tolerances linear about a present model at half of its deviations."""

    def __init__(
        self, predictor: Predictor, declared: ModelParams, num_names: int, weights: Weighting, present: ModelParams
    ) -> None:
        """Store flights, declared model, number of available effects, weights and present model."""
        self.predictor, self.declared, self.weights = predictor, declared, weights
        self.log_names, self._present = float(np.log(max(1, num_names))), present
        self._tolerance: Derivatives | None = None
        self._beside: dict[tuple[Nuisance, ...], Beside] = {}
        self._derivatives: dict[Label, tuple[Fitted, Derivatives]] = {}

    def forget(self) -> None:
        """Clear all caches; they are recomputed on demand."""
        self.forget_beside()
        self.tolerance = None
        self._derivatives.clear()

    def forget_beside(self) -> None:
        """Clear the cached sums of nuisance columns."""
        self._beside.clear()

    @property
    def tolerance(self) -> Derivatives:
        """Return the derivatives by the deviations about the present model, (rows, C, N) of each flight."""
        if self._tolerance is None:
            self._tolerance = tolerance_jacobian(self.predictor, self._present, np.float32)
        return self._tolerance

    @tolerance.setter
    def tolerance(self, known: Derivatives | None) -> None:
        self._tolerance = known

    def beside(self, structures: Sequence[Nuisance], more: Sequence[Array] | None = None) -> Beside:
        """Return the nuisance columns: tolerances, structures and ``more`` columns (rows, C, any), in this order.

        Flight offsets are integrated out.
        """
        key = tuple(structures)
        if more is None and key in self._beside:
            return self._beside[key]
        if more is None and len(self._beside) == KEPT_BESIDE:  # free memory before the next one
            del self._beside[next(iter(self._beside))]
        parts: list[Sequence[Part]] = [self.tolerance, *(one.columns for one in structures if not one.of_flights)]
        flights = list(zip(*parts, *([] if more is None else [more]), strict=True))
        times, weight = self.predictor.times, self.weights.weight
        offsets = offsets_of(structures, self.predictor.channels, weight)
        found = Beside(times, flights, weight, parts=parts_of_a_flight(len(times)), offsets=offsets)
        if more is None:
            self._beside[key] = found
        return found

    def neutral(self, name: str) -> Array:
        """Return the parameters at which an effect changes nothing."""
        return neutral_of(name, self.declared, self.predictor.robot)

    def fit(
        self,
        effects: Sequence[str],
        structures: Sequence[Nuisance],
        start: ModelParams,
        derivatives: Derivatives | None = None,
        *,
        fresh: bool = False,
        frozen: Frozen = frozenset(),
        compared: Compared | None = None,
    ) -> Fitted:
        """Return a set fitted from ``start``, with ``derivatives`` (rows, C, P) at the start if ``fresh``, else near it.

        ``frozen`` parameters are fixed. ``compared``: stopping rule of a comparison fit; None: full convergence.
        """
        beside, effects = self.beside(structures), tuple(effects)
        asked = compared or Compared(least=-np.inf, enough=NOTHING_LEFT)
        goal = Goal(worth=lambda fit: self._about(fit, effects, structures).most, **vars(asked))
        found, last, more = fit_effects(
            self.predictor, effects, start, beside, frozen=frozen, derivatives=derivatives, fresh=fresh, goal=goal
        )
        fitted = self._about(found, effects, structures, more)
        give_back_memory()
        if not frozen:
            self._derivatives[fitted.label] = fitted, single(last)
            if len(self._derivatives) > KEPT:
                del self._derivatives[next(iter(self._derivatives))]
        return fitted

    def _about(self, fit: Fit, effects: tuple[str, ...], structures: Sequence[Nuisance], more: float = 0.0) -> Fitted:
        """Return a set from the linear model about its fit, which may have missed ``more`` log likelihood."""
        parameters, support = NOTHING, {}
        if fit.finite:
            linear = linear_about(fit, [self.neutral(name) for name in effects])
            parameters = posterior(linear.candidates, linear.whole, linear.model)
            support = supports_of_fit(linear, parameters.step, self.log_names)
        free = fit.free_effects.size
        beyond = self.beside(structures).log_likelihood
        value = parameters.log_evidence + beyond - (len(effects) + len(structures)) * self.log_names
        against = sum(max(0.0, -one.log_odds) for one in support.values())
        return Fitted(
            effects=effects,
            structures=tuple(structures),
            params=fit.params,
            log_posterior=value if np.isfinite(value) else -np.inf,
            parameters=parameters,
            support=support,
            most=value + against + more if np.isfinite(value) else np.inf,
            deviation=parameters.step[free : free + self.predictor.num_tolerances],
        )

    def fit_of(
        self,
        library: Library,
        sets: Sets,
        model: Model,
        structures: Sequence[Nuisance],
        compared: Compared | None = None,
    ) -> Fitted:
        """Return a set of a library fitted from the present model, the best over the starts of its new effects."""
        chosen = [library.candidates[k] for k in model]
        beside = {candidate.name for candidate in chosen if candidate.structure}
        kept = [structure for structure in structures if structure.name in beside]
        effects = [k for k in model if not library.candidates[k].structure]
        names, found = [library.candidates[k].name for k in effects], []
        for start in self.starts_of(library, sets, model):
            base = self.predictor.predict(start)
            parts = [
                effect_jacobian(self.predictor, start, (tangent.name,), base)
                if has_starts(tangent.name, self.predictor.robot) and not tangent.named
                else tangent.whole(len(self.predictor.channels))
                for tangent in (library.tangents[k] for k in effects)
            ]
            derivatives = [np.concatenate(columns, axis=2) for columns in zip(*parts, strict=True)] if parts else None
            found.append(self.fit(names, kept, start, derivatives, compared=compared))
        return max(found, key=lambda one: one.log_posterior)

    def starts_of(self, library: Library, sets: Sets, model: Model) -> list[ModelParams]:
        """Return the starts of a set's fit: present values of old effects, the most probable linear step of new ones.

        A strongly nonlinear effect with several starts, such as a pendulum of unknown length, also starts at its linearisation.
        """
        found, step, robot = posterior(sets.candidates, sets.normal, model), 0, self.predictor.robot
        best = plain = self.declared
        for candidate in (library.candidates[k] for k in model if not library.candidates[k].structure):
            values, name = candidate.start.copy(), candidate.name
            numbers = [k for k in range(values.size) if is_number(name, k)]
            if not candidate.named:
                values[numbers] += scales((name,))[numbers] * found.step[step : step + len(numbers)]
                values = np.clip(values, *bounds_of(robot, (name,)))
            step += len(numbers)
            best = best.with_effect(name, values)
            far = has_starts(name, robot) and not has_rotor(name) and not candidate.named
            plain = plain.with_effect(name, candidate.start if far else values)
        same = all(np.array_equal(values, plain.effects[name]) for name, values in best.effects.items())
        return [best] if same else [best, plain]

    def again(self, fitted: Fitted, other: "Fitter") -> Fitted:
        """Return a set refitted from another fitter's result, with its derivatives."""
        known, there = other._derivatives.get(fitted.label), fitted.params
        if known is None or known[0] is not fitted:
            return self.fit(fitted.effects, fitted.structures, there)
        return self.fit(fitted.effects, fitted.structures, there, known[1], fresh=True)

    def without(self, fitted: Fitted, names: Sequence[str], compared: Compared | None = None) -> Fitted:
        """Return a set refitted without some of its effects, which return to their declared values."""
        kept = {name: values for name, values in fitted.params.effects.items() if name not in names}
        kept |= {name: self.declared.effects[name] for name in names if name in self.declared.effects}
        start = ModelParams(effects=kept, learned=self.declared.learned)
        effects = [name for name in fitted.effects if name not in names]
        known = self._derivatives.get(fitted.label)
        derivatives = None
        if known is not None:
            owners = [name for name in fitted.effects for _ in scales((name,))]
            rest = np.array([name not in names for name in owners], dtype=bool)
            derivatives = [part[:, :, rest] for part in known[1]]
        return self.fit(effects, fitted.structures, start, derivatives, compared=compared)

    def without_weakest(self, fitted: Fitted, compared: Compared | None = None) -> Fitted:
        """Return a set refitted without its least supported effect; effects without support count as the least."""
        odds = {name: one.robust_log_odds for name, one in fitted.support.items()}
        return self.without(fitted, (min(fitted.effects, key=lambda name: odds.get(name, -np.inf)),), compared)

    def held(self, fitted: Fitted, holds: Callable[[Fitted], bool] = lambda one: one.holds) -> Fitted:
        """Return the most probable among a set and its subsets whose effects all hold.

        Removal of the weakest effect alone is not enough: an effect with little support beside another may suffice without it.
        So each effect is removed in turn from the best few failing sets of each size, as long as these are more probable
        than the best set that holds.
        """
        level, best = [fitted], None
        while level:
            best = max([one for one in level if holds(one)] + ([best] if best else []), key=_probable, default=None)
            rest = [one for one in level if not holds(one) and (best is None or one.log_posterior > best.log_posterior)]
            less: dict[Label, Fitted] = {}
            for one in sorted(rest, key=_probable, reverse=True)[:BROAD]:
                for name in one.effects:
                    kept = label_of([(other, one.params.effects[other]) for other in one.effects if other != name], ())
                    if kept not in less:
                        less[kept] = self.without(one, (name,))
            if not less and best is None:
                return max(level, key=_probable)
            level = list(less.values())
        assert best is not None
        return best

    def in_file(self, fitted: Fitted) -> tuple[Fitted, dict[str, list[str]]]:
        """Return a set without unsupported effects or parameters at bounds, and the removed effects with those parameters."""
        ends: dict[str, list[str]] = {}
        while True:
            fitted = self.held(fitted)
            again = self.fit(fitted.effects, fitted.structures, self.most_probable(fitted))
            fitted = max([fitted, *([again] if again.holds else [])], key=_probable)
            found = {
                name: at_bounds(name, fitted.params, self.neutral(name), self.predictor.robot)
                for name in fitted.effects
            }
            found = {name: parameters for name, parameters in found.items() if parameters}
            if not found:
                return fitted, ends
            ends |= found
            fitted = self.without(fitted, tuple(found))

    def most_probable(self, fitted: Fitted) -> ModelParams:
        """Return a set's model at its posterior mode, where unobservable parameters follow their prior."""
        params, start = fitted.params, 0
        for name in fitted.effects:
            numbers = [k for k in range(scales((name,)).size) if is_number(name, k)]
            step = fitted.parameters.step[start : start + len(numbers)]
            start += len(numbers)
            values = params.effects[name].copy()
            values[numbers] = self.neutral(name)[numbers] + scales((name,))[numbers] * step
            params = params.with_effect(name, np.clip(values, *bounds_of(self.predictor.robot, (name,))))
        return params

    def narrower(self, fitted: Fitted, names: Sequence[str], compared: Compared | None = None) -> list[Fitted]:
        """Return the fitted sets in which a narrower effect replaces a general one.

        A general effect may win only by its curvature far from neutral: linearised, two lags follow a bend that one cannot.
        """
        found = []
        for wide in fitted.effects:
            for name in EFFECTS.get(wide).contains:
                if name in names and name not in fitted.effects:
                    kept = {other: values for other, values in fitted.params.effects.items() if other != wide}
                    start = ModelParams(effects=kept, learned=self.declared.learned)
                    start = start.with_effect(name, self.neutral(name))
                    effects = [name if other == wide else other for other in fitted.effects]
                    found.append(self.fit(effects, fitted.structures, start, compared=compared))
        return found


def _probable(fitted: Fitted) -> float:
    return fitted.log_posterior


def label_of(effects: Iterable[tuple[str, Array]], structures: Iterable[str]) -> Label:
    """Return the label of a set: effects with parameter vectors, and structures."""
    named = [
        f"{name} {values[0]:.0f}" if EFFECTS.get(name).parameters[0].kind == "rotor" else name
        for name, values in effects
    ]
    return tuple(sorted([*named, *structures]))


def label_in(library: Library, model: Model) -> Label:
    """Return the label of a set of library candidates."""
    chosen = [library.candidates[k] for k in model]
    effects = [(one.name, one.start) for one in chosen if not one.structure]
    return label_of(effects, [one.name for one in chosen if one.structure])
