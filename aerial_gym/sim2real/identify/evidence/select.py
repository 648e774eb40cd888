"""Which effects the flights ask for: the most probable set of effects, fitted, and how probable each is.

All candidates are linearised about the present model; the posterior over sets tells which are worth a fit; each of these is
fitted as it is, not linearised, and its evidence taken there. The best becomes the present model, until none is better.
Every effect must predict flights that its fit has not seen, and be worth more than a trifle.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.evidence.fitting import Fitted, Fitter
from aerial_gym.sim2real.identify.evidence.guard import Guard, Predictive, part_length
from aerial_gym.sim2real.identify.evidence.laplace import Model, Posterior
from aerial_gym.sim2real.identify.evidence.linear import (
    candidates_of,
    evidence_at,
    labels,
    normal_of,
    with_structures,
)
from aerial_gym.sim2real.identify.evidence.search import Sets, search
from aerial_gym.sim2real.identify.evidence.structure import (
    Structure,
    beyond_structures,
    functions_of,
    structures_of,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    effect_jacobian,
    fit_at,
    is_number,
    scales,
    tolerance_jacobian,
    weighting,
)
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, flight_of_rows, time_groups
from aerial_gym.sim2real.identify.selection.library import (
    Library,
    build_library,
    columns_of_starts,
    has_starts,
    neutral_of,
)
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

WORTH_A_FIT = 0.01
"""Probability in the linear model from which on a set is fitted as it is: a less probable one hardly wins by its curvature."""

STEADY = 0.2
"""Share of its mean by which an effect's size may follow a structure (rms) and still be called that effect."""

MATERIAL = 0.05
"""Least relative rise of a residual (rms) without an effect."""

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

    immaterial: dict[str, dict[str, Rise]]
    """Effects that were probable and are worth a trifle in each channel: the rise of its residual without them."""

    refused: dict[str, Predictive]
    """Effects that were probable and predicted the flights of others no better: their law or their parameter is not theirs."""

    std: dict[str, Array]
    """Standard deviation of each parameter of each effect, 0 where it was not fitted."""

    deviation: Array
    """Deviations within the tolerances, in standard deviations, (N,)."""

    weights: Weighting


def choose_effects(
    predictor: Predictor,
    declared: ModelParams,
    names: Sequence[str],
    *,
    material: float = MATERIAL,
    progress: Progress | None = None,
) -> Chosen:
    """Return the set of effects that is most probable given the training flights.

    Args:
        predictor: Training flights.
        declared: The declared model.
        names: Effects that these flights can show.
        material: Least relative rise of a residual (rms) without an effect that is named.
        progress: Told what is being done.
    """
    return _Chooser(predictor, declared, names, material, progress).run()


@dataclass(frozen=True, kw_only=True)
class _View:
    """All candidates about a fitted set."""

    present: Fitted
    fitter: Fitter
    library: Library
    structures: list[Structure]
    sets: Sets
    guard: Guard

    @property
    def here(self) -> Model:
        """Return the set of the candidates that the present model holds."""
        return place_of(self.library, self.present)


class _Chooser:
    """Holds what the rounds share."""

    def __init__(
        self,
        predictor: Predictor,
        declared: ModelParams,
        names: Sequence[str],
        material: float,
        progress: Progress | None,
    ) -> None:
        self.predictor, self.declared, self.names, self.material = predictor, declared, tuple(names), material
        self.skipped = [name for name in EFFECTS if name not in names]
        self.progress = progress or (lambda _stage, _share: None)
        self.missed = predictor.residuals(declared)

    def run(self) -> Chosen:
        """Choose with the weights that the best model leaves, until these no longer change."""
        params, effects, structures = self.declared, (), ()
        weights = self.weigh(params)
        for _ in range(MOST_WEIGHINGS):
            view = self.climb(params, effects, structures, weights)
            params, effects, structures = view.present.params, view.present.effects, view.present.structures
            before, weights = weights, self.weigh(params)
            if np.all(np.abs(np.log(weights.weight / before.weight)) < SETTLED):
                break
        return self.chosen(view)

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
    ) -> _View:
        """Return the best set that fits lead to from a present one, with all candidates about it."""
        fitter = Fitter(self.predictor, self.declared, len(self.names), weights, params)
        present, known = fitter.fit(effects, structures, params), {}
        for count in range(MOST_ROUNDS):
            self.progress(f"sets of effects, round {count + 1}", count / MOST_ROUNDS)
            view = self.look_around(present, fitter)
            best = self.better(view, known)
            if best is present:
                break
            fitter = Fitter(self.predictor, self.declared, len(self.names), weights, best.params)
            present = fitter.fit(best.effects, best.structures, best.params)
        return view

    def better(self, view: _View, known: dict[tuple[str, ...], float]) -> Fitted:
        """Return the best of the probable sets about a model, fitted, or the present one if none is better.

        ``known`` remembers what fits have given: a set that was far behind is not fitted again about another model.
        """
        here, guard, library, log_posterior = view.here, view.guard, view.library, view.sets.log_posterior
        best = view.present if guard.passes(here) else None
        seen, lost = {labels(library, here)} if best else set(), dict[Model, float]()
        log_posterior[here] = view.present.log_posterior
        fewer = [tuple(k for k in here if k != gone) for gone in here if not library.candidates[gone].structure]
        probable = [*worth_a_fit(view.sets, guard), *worth_a_fit(view.sets, guard, structures=False)]
        for model in [*probable, *(model for model in fewer if guard.passes(model))]:
            label = labels(library, model)
            if label in seen:
                continue
            seen.add(label)
            if best is None or known.get(label, np.inf) > best.log_posterior + np.log(WORTH_A_FIT):
                found = view.fitter.fit_of(library, view.sets, model, view.structures)
                known[label] = found.log_posterior
                best = found if best is None or found > best else best
            lost[model] = log_posterior[model] - known.get(label, -np.inf)
        common = max(0.0, float(np.median(list(lost.values())))) if lost else 0.0
        for model in log_posterior:  # what was not fitted would lose by its curvature as well
            log_posterior[model] -= 0.0 if model == here else lost.get(model, common)
        assert best is not None  # the set of no effects passes
        return view.fitter.narrower(best, self.names)

    def look_around(self, present: Fitted, fitter: Fitter) -> _View:
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
        normal = normal_of(library, fitter.weights)
        sets = search(candidates_of(library), normal, starts=[place_of(library, present)])
        return _View(
            present=present,
            fitter=fitter,
            library=library,
            structures=structures,
            sets=sets,
            guard=Guard(library, sets, fitter.weights),
        )

    def chosen(self, view: _View) -> Chosen:
        """Return the result about the last model."""
        library, sets, guard, present = view.library, view.sets, view.guard, view.present
        here = view.here
        refused = {} if guard.passes(sets.best) else guard.of(sets.best)
        guard.leave_out_what_fails()
        probabilities: dict[tuple[str, ...], float] = {}
        for model, probability in sets.probabilities().items():
            key = tuple(sorted(library.candidates[k].name for k in model if not library.candidates[k].structure))
            probabilities[key] = probabilities.get(key, 0.0) + probability
        predictive = guard.of(here)
        surrogates = self.varying(present, view.fitter)
        named = view.fitter.without(present, tuple(surrogates)) if surrogates else present
        named, immaterial = self.without_trifles(named, view.fitter)
        std, start = {}, 0
        spread = np.sqrt(np.diag(named.parameters.covariance))
        for name in named.effects:
            numbers = [k for k in range(scales((name,)).size) if is_number(name, k)]
            std[name] = np.zeros(scales((name,)).size)
            std[name][numbers] = spread[start : start + len(numbers)] * scales((name,))[numbers]
            start += len(numbers)
        return Chosen(
            params=named.params,
            effects=named.effects,
            structures=tuple(structure.name for structure in named.structures),
            probability=probabilities.get(tuple(sorted(present.effects)), 0.0),
            sets=dict(sorted(probabilities.items(), key=lambda item: -item[1])),
            inclusion={
                name: share
                for name, share in sorted(sets.inclusion().items(), key=lambda item: -item[1])
                if name in EFFECTS
            },
            predictive={name: predictive[name] for name in named.effects},
            surrogates=surrogates,
            immaterial=immaterial,
            refused={name: found for name, found in refused.items() if name not in present.effects},
            std=std,
            deviation=named.parameters.step[start : start + self.predictor.num_tolerances],
            weights=view.fitter.weights,
        )

    def without_trifles(self, fitted: Fitted, fitter: Fitter) -> tuple[Fitted, dict[str, dict[str, Rise]]]:
        """Return a set without the effects that are shown to be worth less than what is material, the least one first."""
        found: dict[str, dict[str, Rise]] = {}
        group, flight = time_groups(self.predictor.times), flight_of_rows(self.predictor.times)
        names = [channel.name for channel in self.predictor.channels]
        while fitted.effects:
            residual = np.concatenate(self.predictor.residuals(fitted.params))
            least: tuple[float, str, Fitted, list[Rise]] | None = None
            for name in fitted.effects:
                less = fitter.without(fitted, (name,))
                rises = rise_with_interval(
                    np.concatenate(self.predictor.residuals(less.params)), residual, group, flight
                )
                most = max(rise.high for rise in rises)
                if most < self.material and (least is None or most < least[0]):
                    least = most, name, less, rises
            if least is None:
                return fitted, found
            found[least[1]], fitted = dict(zip(names, least[3], strict=True)), least[2]
        return fitted, found

    def varying(self, present: Fitted, fitter: Fitter) -> dict[str, str]:
        """Return the effects whose size follows a structure that remains, and what it follows: they only stand in for it.

        Never an effect that by its nature follows the same: its law may be off, but its name is right.
        """
        predictor, found = self.predictor, {}
        predicted = predictor.predict(present.params)
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        own = effect_jacobian(predictor, present.params, present.effects, predicted)
        neutral = {name: neutral_of(name, self.declared, predictor.robot) for name in present.effects}

        def log_posterior(*more: list[Array], structures: Sequence[Structure]) -> tuple[float, Posterior]:
            nuisance = with_structures(fitter.tolerance, structures)
            jacobians = [np.concatenate(parts, axis=2) for parts in zip(own, nuisance, *more, strict=True)]
            fit = fit_at(predictor, present.effects, present.params, residuals, jacobians, length=np.inf)
            constant, parameters = evidence_at(fit, list(neutral.values()), fitter.weights)
            return constant + parameters.log_evidence - len(structures) * fitter.log_names, parameters

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
                if varied - fitter.log_names > steady and share > STEADY:
                    found[name] = kind
        return found


def place_of(library: Library, present: Fitted) -> Model:
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
