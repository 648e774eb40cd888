"""Nonlinear fits of sets of effects, and their evidence. Letters: N tolerances."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.candidates.library import (
    Library,
    Tangent,
    has_several_starts,
    is_of_one_rotor,
    law_relatives,
    neutral_params,
)
from aerial_gym.sim2real.identify.candidates.nuisance import NuisanceColumns, prior_of_flight_offsets
from aerial_gym.sim2real.identify.evidence.guard import (
    Support,
    linearise_about_fit,
    num_parts_per_flight,
    supports_of_fit,
)
from aerial_gym.sim2real.identify.evidence.laplace import EMPTY_POSTERIOR, Model, Posterior, posterior
from aerial_gym.sim2real.identify.evidence.search import SetPosterior
from aerial_gym.sim2real.identify.least_squares.derivative_sums import (
    DerivativesWithWeights,
    NuisanceSums,
    Part,
    SparseColumns,
    correct_sparse_columns,
    join_columns,
    split_columns,
)
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    Derivatives,
    effect_jacobian,
    is_continuous_parameter,
    parameter_bounds,
    parameter_scales,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    CONVERGENCE,
    Frozen,
    ModelFit,
    StopRule,
    fit_effects,
)
from aerial_gym.sim2real.identify.least_squares.moments import FlightOffsets, Weighting
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

Label = tuple[str, ...]  # Sorted names of a set's effects, with rotor number, and structures
BROAD = 3  # Number of sets of equal size from which effects are removed
KEPT = 4  # Number of fitted sets whose derivatives are cached
KEPT_BESIDE = 2  # Number of cached sums of nuisance columns
ENOUGH = 2.0  # Log likelihood, times the best set's overdispersion, that a comparison fit may leave to its linear model

_log_posterior = attrgetter("log_posterior")


@dataclass(frozen=True, kw_only=True)
class EffectSetFit:
    """A fitted set of effects and structures."""

    effects: tuple[str, ...]
    structures: tuple[NuisanceColumns, ...]
    params: ModelParams
    log_posterior: float  # Log evidence plus log prior, up to a constant; -inf if the prediction is not finite
    parameters: Posterior  # Posterior of effects, tolerances and structures other than flight offsets, in this order
    support: dict[str, Support]  # Statistical support of each effect
    most: float = np.inf  # Upper limit of the log posterior of this set and its subsets with the same structures
    deviation: Array = field(default_factory=lambda: np.zeros(0))  # Most probable deviations in std, (N,)

    @property
    def is_supported(self) -> bool:
        """Return whether every effect of this fit is more probable than not (guard.py)."""
        return np.isfinite(self.log_posterior) and all(one.is_supported for one in self.support.values())

    @property
    def parameter_overdispersion(self) -> float:
        """Return the parameters' variance between flights over that from noise, at least 1."""
        results = [one.size * one.overdispersion for one in self.support.values()]
        return max(1.0, sum(results) / max(1, sum(one.size for one in self.support.values())))

    @property
    def flight_offsets(self) -> tuple[NuisanceColumns, ...]:
        """Return the structures that are flight offsets."""
        return tuple(structure for structure in self.structures if structure.is_flight_offset)

    @property
    def has_no_structures_but_offsets(self) -> bool:
        """Return whether there are no structures but flight offsets, as required for a robot file."""
        return self.flight_offsets == self.structures

    @property
    def model_with_deviations(self) -> ModelParams:
        """Return the model with its most probable deviations."""
        return replace(self.params, deviation=self.deviation)

    @property
    def label(self) -> Label:
        """Return the label of the set."""
        effects = [(name, self.params.effects[name]) for name in self.effects]
        return set_label(effects, [structure.name for structure in self.structures])


class Fitter:
    """Fits sets of effects, with tolerances linear about a present model at half of its deviations."""

    def __init__(
        self, predictor: Predictor, declared: ModelParams, num_names: int, weights: Weighting, present: ModelParams
    ) -> None:
        self.predictor, self.declared, self.weights = predictor, declared, weights
        self.log_prior_cost_of_effect, self._present = float(np.log(max(1, num_names))), present
        self.tolerances: SparseColumns | None = None  # Derivatives by each deviation about the present model, if known
        self._beside: dict[tuple[NuisanceColumns, ...], NuisanceSums] = {}
        self._derivatives: dict[Label, tuple[EffectSetFit, SparseColumns]] = {}

    def clear_caches(self) -> None:
        """Clear all caches; they are recomputed on demand."""
        self.clear_nuisance_sums()
        self.tolerances = None
        self._derivatives.clear()

    def clear_nuisance_sums(self) -> None:
        """Clear the cached sums of nuisance columns."""
        self._beside.clear()

    def tolerance_columns(self) -> SparseColumns:
        """Return the derivatives by each deviation about the present model, computed if they are not known."""
        if self.tolerances is None:
            self.tolerances = split_columns(tolerance_jacobian(self.predictor, self._present, np.float32))
        return self.tolerances

    def secant_tolerances(self, fitted: EffectSetFit) -> SparseColumns:
        """Return these derivatives after a least correction, by which they give the exact change over a set's deviations."""
        moved, base = (self.predictor.predict(one) for one in (fitted.model_with_deviations, fitted.params))
        change = [m - b for m, b in zip(moved, base, strict=True)]
        return correct_sparse_columns(self.tolerance_columns(), fitted.deviation, change)

    def nuisance_sums(self, structures: Sequence[NuisanceColumns], more: Sequence[Array] | None = None) -> NuisanceSums:
        """Return tolerances, structures and ``more`` columns (rows, C, any), in this order, without flight offsets."""
        key, weight, times = tuple(structures), self.weights.weight, self.predictor.times
        if more is None and key in self._beside:
            return self._beside[key]
        offsets = prior_of_flight_offsets(structures, self.predictor.channels, weight)
        first = self._tolerances_with_weights(offsets)
        if more is None and len(self._beside) == KEPT_BESIDE:  # free memory before the next one
            del self._beside[next(iter(self._beside))]
        parts: list[Sequence[Part]] = [one.columns for one in structures if not one.is_flight_offset]
        parts += [] if more is None else [more]
        flights = list(zip(*parts, strict=True)) if parts else [()] * len(times)
        results = NuisanceSums(
            times, flights, weight, parts=num_parts_per_flight(len(times)), offsets=offsets, first=first
        )
        if more is None:
            self._beside[key] = results
        return results

    def _tolerances_with_weights(self, offsets: FlightOffsets) -> DerivativesWithWeights:
        """Return the derivatives by the deviations with weights, shared with cached sums of the same flight offsets."""
        for known in self._beside.values():
            if known.first is not None and np.array_equal(known.offsets.size, offsets.size):
                return known.first
        return DerivativesWithWeights(list(zip(*self.tolerance_columns(), strict=True)), offsets)

    def neutral_of_effect(self, name: str) -> Array:
        """Return the parameters at which an effect changes nothing."""
        return neutral_params(name, self.declared, self.predictor.robot)

    def fit(
        self, effects: Sequence[str], structures: Sequence[NuisanceColumns], start: ModelParams,
        derivatives: Derivatives | None = None, *, fresh: bool = False, frozen: Frozen = frozenset(),
        rule: StopRule = CONVERGENCE,
    ) -> EffectSetFit:  # fmt: skip
        """Return a set fitted from ``start``, with ``derivatives`` (rows, C, P) at the start if ``fresh``, else near it.

        ``frozen`` parameters are fixed. Without a ``rule`` the fit converges.
        """
        beside, effects = self.nuisance_sums(structures), tuple(effects)
        rule = replace(rule, worth=lambda fit: self._fit_with_evidence(fit, effects, structures).most)
        results, last, more = fit_effects(
            self.predictor, effects, start, beside, frozen=frozen, derivatives=derivatives, fresh=fresh, rule=rule
        )
        fitted = self._fit_with_evidence(results, effects, structures, more)
        give_back_memory()
        if not frozen:
            self._derivatives[fitted.label] = fitted, split_columns(last)
            if len(self._derivatives) > KEPT:
                del self._derivatives[next(iter(self._derivatives))]
        return fitted

    def _fit_with_evidence(
        self, fit: ModelFit, effects: tuple[str, ...], structures: Sequence[NuisanceColumns], more: float = 0.0
    ) -> EffectSetFit:
        """Return a set from the linear model about its fit, which may have missed ``more`` log likelihood."""
        parameters, support = EMPTY_POSTERIOR, {}
        if fit.is_finite:
            linear = linearise_about_fit(fit, [self.neutral_of_effect(name) for name in effects])
            parameters = posterior(linear.candidates, linear.whole, linear.set_of_all)
            support = supports_of_fit(linear, parameters.step, self.log_prior_cost_of_effect)
        free = fit.indices_of_fitted_effect_params.size
        beyond = self.nuisance_sums(structures).log_likelihood
        value = parameters.log_evidence + beyond - (len(effects) + len(structures)) * self.log_prior_cost_of_effect
        against = sum(max(0.0, -one.log_odds) for one in support.values())
        return EffectSetFit(
            effects=effects,
            structures=tuple(structures),
            params=fit.params,
            log_posterior=value if np.isfinite(value) else -np.inf,
            parameters=parameters,
            support=support,
            most=value + against + more if np.isfinite(value) else np.inf,
            deviation=parameters.step[free : free + self.predictor.num_tolerances],
        )

    def fit_set(
        self, library: Library, sets: SetPosterior, model: Model, structures: Sequence[NuisanceColumns],
        rule: StopRule = CONVERGENCE,
    ) -> EffectSetFit:  # fmt: skip
        """Return a set of a library fitted from the present model, the best over the starts of its new effects."""
        chosen = [library.candidates[k] for k in model]
        beside = {candidate.name for candidate in chosen if candidate.structure}
        kept = [structure for structure in structures if structure.name in beside]
        effects = [k for k in model if not library.candidates[k].structure]
        names, results = [library.candidates[k].name for k in effects], []
        tangents = [library.tangents[k] for k in effects]
        for start in self.start_models_of_fit(library, sets, model):
            results.append(self.fit(names, kept, start, self._derivatives_at_start(tangents, start), rule=rule))
        return max(results, key=_log_posterior)

    def _derivatives_at_start(self, tangents: Sequence[Tangent], start: ModelParams) -> Derivatives | None:
        """Return the derivatives of effects near a start, (rows, C, P) each, new ones where effects have several starts."""
        base, channels = self.predictor.predict(start), len(self.predictor.channels)
        parts = [
            effect_jacobian(self.predictor, start, (tangent.name,), base)
            if has_several_starts(tangent.name, self.predictor.robot) and not tangent.named
            else tangent.dense_derivatives(channels)
            for tangent in tangents
        ]
        return [np.concatenate(columns, axis=2) for columns in zip(*parts, strict=True)] if parts else None

    def start_models_of_fit(self, library: Library, sets: SetPosterior, model: Model) -> list[ModelParams]:
        """Return the starts of a set's fit: old effects as present, new ones by a linear step, or far from it unmoved."""
        results, step, robot = posterior(sets.candidates, sets.normal, model), 0, self.predictor.robot
        best = plain = self.declared
        for candidate in (library.candidates[k] for k in model if not library.candidates[k].structure):
            values, name = candidate.start.copy(), candidate.name
            numbers = [k for k in range(values.size) if is_continuous_parameter(name, k)]
            if not candidate.named:
                values[numbers] += parameter_scales((name,))[numbers] * results.step[step : step + len(numbers)]
                values = np.clip(values, *parameter_bounds(robot, (name,)))
            step += len(numbers)
            best = best.with_effect(name, values)
            far = has_several_starts(name, robot) and not is_of_one_rotor(name) and not candidate.named
            plain = plain.with_effect(name, candidate.start if far else values)
        same = all(np.array_equal(values, plain.effects[name]) for name, values in best.effects.items())
        return [best] if same else [best, plain]

    def refit_from_other_fitter(
        self, fitted: EffectSetFit, other: "Fitter", rule: StopRule = CONVERGENCE
    ) -> EffectSetFit:
        """Return a set refitted from another fitter's result, with its derivatives."""
        known, there = other._derivatives.get(fitted.label), fitted.params
        if known is None or known[0] is not fitted:
            return self.fit(fitted.effects, fitted.structures, there, rule=rule)
        derivatives = self._join_columns(known[1])
        return self.fit(fitted.effects, fitted.structures, there, derivatives, fresh=True, rule=rule)

    def refit_without_effects(
        self, fitted: EffectSetFit, names: Sequence[str], rule: StopRule = CONVERGENCE
    ) -> EffectSetFit:
        """Return a set refitted without some of its effects, which return to their declared values."""
        start = replace(params_without_effects(fitted.params, names, self.declared), learned=self.declared.learned)
        effects = [name for name in fitted.effects if name not in names]
        known = self._derivatives.get(fitted.label)
        derivatives = None
        if known is not None:
            owners = [name for name in fitted.effects for _ in parameter_scales((name,))]
            derivatives = self._join_columns([c for name, c in zip(owners, known[1], strict=True) if name not in names])
        return self.fit(effects, fitted.structures, start, derivatives, rule=rule)

    def _join_columns(self, columns: SparseColumns) -> Derivatives:
        """Return columns as dense derivatives of each flight, (rows, C, P)."""
        empty = [np.empty((*part.shape, 0), dtype=np.float32) for part in self.predictor.measured]
        return join_columns(columns, len(self.predictor.channels)) if columns else empty

    def refit_without_weakest(self, fitted: EffectSetFit, rule: StopRule = CONVERGENCE) -> EffectSetFit:
        """Return a set refitted without its least supported effect; effects without support count as the least."""
        odds = {name: one.log_odds_with_overdispersion for name, one in fitted.support.items()}
        weakest = min(fitted.effects, key=lambda name: odds.get(name, -np.inf))
        return self.refit_without_effects(fitted, (weakest,), rule)

    def drop_unsupported(
        self, fitted: EffectSetFit, holds: Callable[[EffectSetFit], bool] = lambda one: one.is_supported
    ) -> EffectSetFit:
        """Return the most probable among a set and its subsets whose effects all hold.

        An effect with little support beside another may suffice without it. So each effect is removed in turn from the best
        few failing sets of each size, as long as these are more probable than the best set that holds.
        """
        level, best = [fitted], None
        while level:
            holding = [one for one in level if holds(one)]
            best = max(holding + ([best] if best else []), key=_log_posterior, default=None)
            rest = [one for one in level if not holds(one) and (best is None or one.log_posterior > best.log_posterior)]
            less: dict[Label, EffectSetFit] = {}
            for one in sorted(rest, key=_log_posterior, reverse=True)[:BROAD]:
                for name in one.effects:
                    kept = set_label([(other, one.params.effects[other]) for other in one.effects if other != name], ())
                    if kept not in less:
                        less[kept] = self.refit_without_effects(one, (name,))
            if not less and best is None:
                return max(level, key=_log_posterior)
            level = list(less.values())
        assert best is not None
        return best

    def set_for_robot_file(self, fitted: EffectSetFit) -> EffectSetFit:
        """Return a set without unsupported effects, at its posterior mode if that is more probable."""
        fitted = self.drop_unsupported(fitted)
        again = self.fit(fitted.effects, fitted.structures, self.params_at_mode(fitted))
        return max([fitted, *([again] if again.is_supported else [])], key=_log_posterior)

    def params_at_mode(self, fitted: EffectSetFit) -> ModelParams:
        """Return a set's model at its posterior mode, where unobservable parameters follow their prior."""
        params, start = fitted.params, 0
        for name in fitted.effects:
            numbers = [k for k in range(parameter_scales((name,)).size) if is_continuous_parameter(name, k)]
            step = fitted.parameters.step[start : start + len(numbers)]
            start += len(numbers)
            values = params.effects[name].copy()
            values[numbers] = self.neutral_of_effect(name)[numbers] + parameter_scales((name,))[numbers] * step
            params = params.with_effect(name, np.clip(values, *parameter_bounds(self.predictor.robot, (name,))))
        return params

    def fit_other_laws(
        self, fitted: EffectSetFit, names: Sequence[str], rule: StopRule = CONVERGENCE
    ) -> list[EffectSetFit]:
        """Return the fits with another law in place of an effect: a special case, or a law that is no candidate by itself.

        Such a law starts at the fitted parameters of the same names. A law that the robot file declares is not replaced.
        """
        results = []
        for old in fitted.effects:
            for name in EFFECTS.get(old).contains if old in self.declared.effects else laws_in_place(old):
                if name in names and name not in fitted.effects:
                    kept = {other: values for other, values in fitted.params.effects.items() if other != old}
                    start = ModelParams(effects=kept, learned=self.declared.learned)
                    start = start.with_effect(name, self._start_of_law(name, old, fitted.params.effects[old]))
                    effects = [name if other == old else other for other in fitted.effects]
                    results.append(self.fit(effects, fitted.structures, start, rule=rule))
        return results

    def _start_of_law(self, name: str, old: str, values: Array) -> Array:
        """Return the start of a law in place of an old one with fitted ``values``; neutral if they are of other causes."""
        start, own, former = self.neutral_of_effect(name).copy(), EFFECTS.get(name), EFFECTS.get(old)
        if own.cause == former.cause:
            by_name = {parameter.name: float(value) for parameter, value in zip(former.parameters, values, strict=True)}
            known = own.start_in_place(former.in_first_law(by_name))
            start = np.array([known.get(p.name, value) for p, value in zip(own.parameters, start, strict=True)])
        return start


def params_without_effects(params: ModelParams, names: Collection[str], declared: ModelParams) -> ModelParams:
    """Return model parameters without some effects, which return to their declared values."""
    kept = {name: values for name, values in params.effects.items() if name not in names}
    return replace(params, effects=kept | {name: declared.effects[name] for name in names if name in declared.effects})


def laws_in_place(old: str) -> tuple[str, ...]:
    """Return the special cases of an effect, and the laws of its cause that are fitted only in place of others."""
    cases, in_place = EFFECTS.get(old).contains, EFFECTS.get(old).in_place
    return cases + tuple(
        name for name in law_relatives(old) if name not in cases and (in_place or EFFECTS.get(name).in_place)
    )


def set_label(effects: Iterable[tuple[str, Array]], structures: Iterable[str]) -> Label:
    """Return the label of a set: effects with parameter vectors, and structures."""
    named = [
        f"{name} {values[0]:.0f}" if EFFECTS.get(name).parameters[0].kind == "rotor" else name
        for name, values in effects
    ]
    return tuple(sorted([*named, *structures]))


def label_of_candidate_set(library: Library, model: Model) -> Label:
    """Return the label of a set of library candidates."""
    chosen = [library.candidates[k] for k in model]
    effects = [(one.name, one.start) for one in chosen if not one.structure]
    return set_label(effects, [one.name for one in chosen if one.structure])
