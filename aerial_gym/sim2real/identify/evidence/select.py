"""Which effects the flights ask for: the most probable set of effects, fitted, and how probable each is.

All candidates are linearised about the present model; the posterior over sets tells which are worth a fit; each of these is
fitted as it is, not linearised, and its evidence taken there. The best becomes the present model, until none is better.
Then every effect must have predicted flights that its fit has not seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.evidence.guard import Guard, Predictive, part_length
from aerial_gym.sim2real.identify.evidence.laplace import Model, Posterior, posterior
from aerial_gym.sim2real.identify.evidence.linear import candidates_of, evidence_at, labels, normal_of, with_structures
from aerial_gym.sim2real.identify.evidence.search import Sets, search
from aerial_gym.sim2real.identify.evidence.structure import (
    Structure,
    beyond_structures,
    functions_of,
    structures_of,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    bounds_of,
    effect_jacobian,
    fit_at,
    fit_effects,
    is_number,
    scales,
    tolerance_jacobian,
    weighting,
)
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.library import (
    Library,
    build_library,
    columns_of_starts,
    has_starts,
    neutral_of,
)
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

WORTH_A_FIT = 0.01
"""Probability in the linear model from which on a set is fitted as it is: a less probable one hardly wins by its curvature."""

STEADY = 0.2
"""Share of its mean by which an effect's size may follow a structure (rms) and still be called that effect."""

MOST_ROUNDS = 8
MOST_WEIGHINGS = 3
SETTLED = 0.3
"""The weights of the channels are taken anew until none changes by more than this on the scale of the logarithm."""


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """The most probable set of effects."""

    params: ModelParams
    """The fitted model."""

    effects: tuple[str, ...]
    structures: tuple[str, ...]
    """What remains and no effect has, by kind and channel."""

    probability: float
    """Of exactly these effects."""

    sets: dict[tuple[str, ...], float]
    """Probability of each set of effects, the most probable first, whatever the structure beside them."""

    inclusion: dict[str, float]
    """Probability of each effect: that of all sets that hold it."""

    predictive: dict[str, Predictive]
    """Of each effect of the set."""

    surrogates: dict[str, str]
    """Effects that only stand in for what remains, and what their size follows."""

    refused: dict[str, Predictive]
    """Effects that were probable and predicted the flights of others no better: their law or their parameter is not theirs."""

    std: dict[str, Array]
    """Standard deviation of each parameter of each effect, 0 where it was not fitted."""

    deviation: Array
    """Deviations within the tolerances, in standard deviations, (N,)."""

    weights: Weighting


def choose_effects(
    predictor: Predictor, declared: ModelParams, names: Sequence[str], *, progress: Progress | None = None
) -> Chosen:
    """Return the set of effects that is most probable given the training flights.

    Args:
        predictor: Training flights.
        declared: The declared model.
        names: Effects that these flights can show.
        progress: Told what is being done.
    """
    return _Chooser(predictor, declared, names, progress).run()


@dataclass(frozen=True, kw_only=True)
class _Present:
    """A set of effects, fitted."""

    effects: tuple[str, ...]
    structures: tuple[Structure, ...]
    params: ModelParams
    log_posterior: float
    parameters: Posterior


class _Chooser:
    """Holds what the rounds share."""

    def __init__(
        self, predictor: Predictor, declared: ModelParams, names: Sequence[str], progress: Progress | None
    ) -> None:
        self.predictor, self.declared, self.names = predictor, declared, tuple(names)
        self.skipped = [name for name in EFFECTS if name not in names]
        self.progress = progress or (lambda _stage, _share: None)
        self.tolerance: list[Array] = []
        self.missed = predictor.residuals(declared)

    def run(self) -> Chosen:
        """Choose with the weights that the best model leaves, until these no longer change."""
        params, effects, structures = self.declared, (), ()
        weights = self.weigh(params)
        for _ in range(MOST_WEIGHINGS):
            present = self.climb(params, effects, structures, weights)
            params, effects, structures = present.params, present.effects, present.structures
            before, weights = weights, self.weigh(params)
            if np.all(np.abs(np.log(weights.weight / before.weight)) < SETTLED):
                break
        return self.chosen(present, before)

    def varying(self, present: _Present, weights: Weighting) -> dict[str, str]:
        """Return the effects whose size follows a structure that remains, and what it follows: they only stand in for it.

        Never an effect that by its nature follows the same: its law may be off, but its name is right.
        """
        predictor, found = self.predictor, {}
        predicted = predictor.predict(present.params)
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        own = effect_jacobian(predictor, present.params, present.effects, predicted)
        neutral = {name: neutral_of(name, self.declared, predictor.robot) for name in present.effects}

        def log_posterior(*more: list[Array], structures: Sequence[Structure]) -> tuple[float, Posterior]:
            nuisance = with_structures(self.tolerance, structures)
            jacobians = [np.concatenate(parts, axis=2) for parts in zip(own, nuisance, *more, strict=True)]
            fit = fit_at(predictor, present.effects, present.params, residuals, jacobians, length=np.inf)
            constant, parameters = evidence_at(fit, list(neutral.values()), weights)
            return constant + parameters.log_evidence - len(structures) * float(np.log(len(self.names))), parameters

        kinds = {structure.kind for structure in present.structures} - {"periodic"}
        for name, kind in ((name, kind) for name in present.effects for kind in sorted(kinds)):
            if kind in EFFECTS.get(name).follows or name in found:
                continue
            without = predictor.predict(present.params.with_effect(name, neutral[name]))
            functions = functions_of(kind, predictor.flights, predictor.times)
            columns = [(p - w)[..., None] * f[:, None] for p, w, f in zip(predicted, without, functions, strict=True)]
            rest = [structure for structure in present.structures if structure.kind != kind]
            steady, _ = log_posterior(structures=present.structures)
            for beside in (present.structures, rest):
                varied, parameters = log_posterior(columns, structures=beside)
                share = float(np.sqrt((parameters.step[-columns[0].shape[2] :] ** 2).sum()))
                if varied - np.log(len(self.names)) > steady and share > STEADY:
                    found[name] = kind
        return found

    def weigh(self, params: ModelParams) -> Weighting:
        """Return the weights of the channels from what all effects and structures together leave over."""
        common = tuple(name for name in self.names if not has_starts(name, self.predictor.robot))
        several = [name for name in self.names if name not in common and name not in params.effects]
        tolerance = tolerance_jacobian(self.predictor, params, self.predictor.predict(params))
        flights, times, channels = self.predictor.flights, self.predictor.times, self.predictor.channels

        def beyond(residuals: list[Array], weights: Weighting) -> list[Array]:
            structures = structures_of(flights, times, channels, self.missed, residuals, {})
            return beyond_structures(structures, residuals, weights)

        columns = columns_of_starts(self.predictor, params, self.declared, several, tolerance)
        return weighting(self.predictor, params, common, columns, beyond=beyond)

    def climb(
        self, params: ModelParams, effects: tuple[str, ...], structures: tuple[Structure, ...], weights: Weighting
    ) -> _Present:
        """Return the best set that fits lead to from a present one."""
        self.tolerance = tolerance_jacobian(self.predictor, params, self.predictor.predict(params))
        present = self.fit(effects, structures, params, weights)
        for count in range(MOST_ROUNDS):
            self.progress(f"sets of effects, round {count + 1}", count / MOST_ROUNDS)
            library, sets, around = self.look_around(present, weights)
            guard = Guard(library, sets, weights)
            here = place_of(library, present)
            best = present if guard.passes(here) else None
            # Anew in each round: another model bends the tolerances.
            fitted = {labels(library, here)} if best else set()
            for model in [*worth_a_fit(sets, guard), *worth_a_fit(sets, guard, structures=False)]:
                label = labels(library, model)
                if label in fitted:
                    continue
                fitted.add(label)
                chosen = {library.candidates[k].name for k in model if library.candidates[k].structure}
                names = tuple(library.candidates[k].name for k in model if not library.candidates[k].structure)
                beside = tuple(structure for structure in around if structure.name in chosen)
                for start in self.starts_of(library, sets, model):
                    found = self.fit(names, beside, start, weights)
                    if np.isfinite(found.log_posterior) and (best is None or found.log_posterior > best.log_posterior):
                        best = found
            assert best is not None  # the set of no effects passes
            best = self.narrower(best, weights)
            if best is present:
                break
            self.tolerance = tolerance_jacobian(self.predictor, best.params, self.predictor.predict(best.params))
            present = self.fit(best.effects, best.structures, best.params, weights)
        return present

    def narrower(self, present: _Present, weights: Weighting) -> _Present:
        """Return the best of a set and of those with an effect in the place of a wider case of it.

        A wide case can be better only by its curvature where both are far from neutral: two lags follow a bend that one
        cannot in a linear model.
        """
        best = present
        for wide in present.effects:
            for name in EFFECTS.get(wide).contains:
                if name in self.names and name not in present.effects:
                    kept = {other: params for other, params in present.params.effects.items() if other != wide}
                    start = ModelParams(effects=kept, learned=self.declared.learned)
                    start = start.with_effect(name, neutral_of(name, self.declared, self.predictor.robot))
                    effects = tuple(name if other == wide else other for other in present.effects)
                    found = self.fit(effects, present.structures, start, weights)
                    best = max(best, found, key=lambda one: one.log_posterior)
        return best

    def look_around(self, present: _Present, weights: Weighting) -> tuple[Library, Sets, list[Structure]]:
        """Return all candidates about a model, the posterior over their sets, and the structures among them."""
        flights, times, channels = self.predictor.flights, self.predictor.times, self.predictor.channels
        structures: list[Structure] = []

        def of_residuals(residuals: list[Array], effects: dict[str, list[Array]]) -> list[Structure]:
            structures.extend(structures_of(flights, times, channels, self.missed, residuals, effects))
            return structures

        library = build_library(
            self.predictor,
            self.declared,
            present.params,
            present.effects,
            skipped=self.skipped,
            structures=of_residuals,
            length=part_length(times),
        )
        normal = normal_of(library, weights)
        sets = search(candidates_of(library), normal, starts=[place_of(library, present)])
        return library, sets, structures

    def starts_of(self, library: Library, sets: Sets, model: Model) -> list[ModelParams]:
        """Return where the fit of a set starts: at its most probable parameters in the linear model.

        An effect that is linearised at several starts, a pendulum of many lengths, is far from linear: it starts there too.
        """
        found, step, robot = posterior(sets.candidates, sets.normal, model), 0, self.predictor.robot
        best = plain = self.declared
        for candidate in (library.candidates[k] for k in model if not library.candidates[k].structure):
            values, name = candidate.start.copy(), candidate.name
            numbers = [k for k in range(values.size) if is_number(name, k)]
            if candidate.named:  # linear from neutral on; others from where they start
                values[numbers] = neutral_of(name, self.declared, robot)[numbers]
            values[numbers] += scales((name,))[numbers] * found.step[step : step + len(numbers)]
            step += len(numbers)
            low, high = bounds_of(robot, (name,))
            values = np.clip(values, low, high)
            best = best.with_effect(name, values)
            far = has_starts(name, robot) and not candidate.named
            plain = plain.with_effect(name, candidate.start if far else values)
        same = all(np.array_equal(values, plain.effects[name]) for name, values in best.effects.items())
        return [best] if same else [best, plain]

    def fit(
        self, effects: tuple[str, ...], structures: tuple[Structure, ...], start: ModelParams, weights: Weighting
    ) -> _Present:
        """Return a set fitted from a start, with its log posterior: evidence at the fit, and prior of the set."""
        nuisance = with_structures(self.tolerance, structures)
        found = fit_effects(self.predictor, effects, start, nuisance, weights.weight)
        neutral = [neutral_of(name, self.declared, self.predictor.robot) for name in effects]
        constant, parameters = evidence_at(found, neutral, weights)
        return _Present(
            effects=effects,
            structures=structures,
            params=found.point,
            log_posterior=constant
            + parameters.log_evidence
            - (len(effects) + len(structures)) * float(np.log(len(self.names))),
            parameters=parameters,
        )

    def chosen(self, present: _Present, weights: Weighting) -> Chosen:
        """Return the result about the last model."""
        library, sets, _ = self.look_around(present, weights)
        here, guard = place_of(library, present), Guard(library, sets, weights)
        refused = {} if guard.passes(sets.best) else guard.of(sets.best)
        guard.leave_out_what_fails()
        probabilities: dict[tuple[str, ...], float] = {}
        for model, probability in sets.probabilities().items():
            key = tuple(sorted(library.candidates[k].name for k in model if not library.candidates[k].structure))
            probabilities[key] = probabilities.get(key, 0.0) + probability
        surrogates = self.varying(present, weights)
        kept = {name: values for name, values in present.params.effects.items() if name not in surrogates}
        kept |= {name: self.declared.effects[name] for name in surrogates if name in self.declared.effects}
        std, start = {}, 0
        spread = np.sqrt(np.diag(present.parameters.covariance))
        for name in present.effects:
            numbers = [k for k in range(scales((name,)).size) if is_number(name, k)]
            std[name] = np.zeros(scales((name,)).size)
            std[name][numbers] = spread[start : start + len(numbers)] * scales((name,))[numbers]
            start += len(numbers)
        return Chosen(
            params=replace(present.params, effects=kept),
            effects=tuple(name for name in present.effects if name not in surrogates),
            structures=tuple(structure.name for structure in present.structures),
            probability=probabilities.get(tuple(sorted(present.effects)), 0.0),
            sets=dict(sorted(probabilities.items(), key=lambda item: -item[1])),
            inclusion={
                name: share
                for name, share in sorted(sets.inclusion().items(), key=lambda item: -item[1])
                if name in EFFECTS
            },
            predictive={name: found for name, found in guard.of(here).items() if name not in surrogates},
            surrogates=surrogates,
            refused={name: found for name, found in refused.items() if name not in present.effects},
            std=std,
            deviation=present.parameters.step[start : start + self.predictor.num_tolerances],
            weights=weights,
        )


def place_of(library: Library, present: _Present) -> Model:
    """Return the set of the candidates that the present model holds."""
    beside = {structure.name for structure in present.structures}
    return tuple(
        k for k, found in enumerate(library.candidates) if found.named or (found.structure and found.name in beside)
    )


def worth_a_fit(sets: Sets, guard: Guard, *, structures: bool = True) -> list[Model]:
    """Return the probable sets that pass the guard, the most probable first; without ``structures`` those that have none.

    Several structures together can make what an effect with a memory or a range makes, better than the effect where it is
    linear: therefore sets without them have their own turn.
    """
    top, found = 0.0, []
    for model, probability in sets.probabilities().items():
        if probability < WORTH_A_FIT * top:
            break
        if (structures or not sets.candidates.structures.intersection(model)) and guard.passes(model):
            top = max(top, probability)
            found.append(model)
    return found
