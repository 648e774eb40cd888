"""Which effects the flights ask for: the most probable set of effects, fitted, and how probable each is.

All candidates are linearised about the present model; the posterior over sets tells which are worth a fit; each of these is
fitted as it is, not linearised, and its evidence taken there. The best becomes the present model, until none is better.
Then every effect must have predicted flights that its fit has not seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, Normal, Posterior, posterior
from aerial_gym.sim2real.identify.evidence.search import Sets, search
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    Fit,
    fit_effects,
    is_number,
    normal_equations,
    params_of,
    scales,
    tolerance_jacobian,
    weighting,
    with_params,
)
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, folds
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

MOST_ROUNDS = 8
MOST_WEIGHINGS = 3
SETTLED = 0.3
"""The weights of the channels are taken anew until none changes by more than this on the scale of the logarithm."""


@dataclass(frozen=True, kw_only=True)
class Predictive:
    """What an effect adds to the log density of flights that are left out, each predicted by the posterior of the others."""

    gain: float
    """Sum over the flights."""

    error: float
    """Standard error of the sum, from the scatter of the flights."""

    @property
    def ratio(self) -> float:
        """Return the gain in standard errors."""
        return self.gain / max(self.error, 1e-12)


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """The most probable set of effects."""

    params: ModelParams
    """The fitted model."""

    effects: tuple[str, ...]
    probability: float
    """Of exactly this set."""

    sets: dict[tuple[str, ...], float]
    """Probability of each set, the most probable first."""

    inclusion: dict[str, float]
    """Probability of each effect: that of all sets that hold it."""

    predictive: dict[str, Predictive]
    """Of each effect of the set."""

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

    def run(self) -> Chosen:
        """Choose with the weights that the best model leaves, until these no longer change."""
        params, effects = self.declared, ()
        weights = self.weigh(params)
        for _ in range(MOST_WEIGHINGS):
            present = self.climb(params, effects, weights)
            params, effects = present.params, present.effects
            before, weights = weights, self.weigh(params)
            if np.all(np.abs(np.log(weights.weight / before.weight)) < SETTLED):
                break
        return self.chosen(present, before)

    def weigh(self, params: ModelParams) -> Weighting:
        """Return the weights of the channels from what all candidates together leave over."""
        common = tuple(name for name in self.names if not has_starts(name, self.predictor.robot))
        several = [name for name in self.names if name not in common and name not in params.effects]
        tolerance = tolerance_jacobian(self.predictor, params, self.predictor.predict(params))
        return weighting(
            self.predictor, params, common, columns_of_starts(self.predictor, params, self.declared, several, tolerance)
        )

    def climb(self, params: ModelParams, effects: tuple[str, ...], weights: Weighting) -> _Present:
        """Return the best set that fits lead to from a present one."""
        self.tolerance = tolerance_jacobian(self.predictor, params, self.predictor.predict(params))
        present = self.fit(effects, params, weights)
        for count in range(MOST_ROUNDS):
            self.progress(f"sets of effects, round {count + 1}", count / MOST_ROUNDS)
            library, sets = self.look_around(present, weights)
            here, best = place_of(library), present
            fitted = {labels(library, here)}  # anew in each round: another model bends the tolerances otherwise
            for model, probability in sets.probabilities().items():
                label = labels(library, model)
                if probability < WORTH_A_FIT or sets.look(model) < sets.look(here):
                    break
                if label in fitted:
                    continue
                fitted.add(label)
                names = tuple(library.candidates[k].name for k in model)
                found = self.fit(names, self.start_of(library, sets, model), weights)
                best = max(best, found, key=lambda one: one.log_posterior)
            best = self.narrower(best, weights)
            if best is present:
                break
            self.tolerance = tolerance_jacobian(self.predictor, best.params, self.predictor.predict(best.params))
            present = self.fit(best.effects, best.params, weights)
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
                    best = max(best, self.fit(effects, start, weights), key=lambda one: one.log_posterior)
        return best

    def look_around(self, present: _Present, weights: Weighting) -> tuple[Library, Sets]:
        """Return all candidates about a model, and the posterior over their sets."""
        library = build_library(self.predictor, self.declared, present.params, present.effects, skipped=self.skipped)
        normal = normal_of(library, weights)
        return library, search(candidates_of(library), normal, starts=[place_of(library)])

    def start_of(self, library: Library, sets: Sets, model: Model) -> ModelParams:
        """Return the model with the most probable parameters of a set in the linear model."""
        found, step, params = posterior(sets.candidates, sets.normal, model), 0, self.declared
        for candidate in (library.candidates[k] for k in model):
            values, numbers = (
                candidate.start.copy(),
                [k for k in range(candidate.start.size) if is_number(candidate.name, k)],
            )
            neutral, scale = neutral_of(candidate.name, self.declared, self.predictor.robot), scales((candidate.name,))
            values[numbers] = neutral[numbers] + scale[numbers] * found.step[step : step + len(numbers)]
            step += len(numbers)
            params = params.with_effect(candidate.name, values)
        names = tuple(library.candidates[k].name for k in model)
        return with_params(self.predictor.robot, params, names, params_of(params, names))

    def fit(self, effects: tuple[str, ...], start: ModelParams, weights: Weighting) -> _Present:
        """Return a set fitted from a start, with its log posterior: evidence at the fit, and prior of the set."""
        found = fit_effects(self.predictor, effects, start, self.tolerance, weights.weight)
        neutral = [neutral_of(name, self.declared, self.predictor.robot) for name in effects]
        constant, parameters = evidence_at(found, neutral, weights)
        return _Present(
            effects=effects,
            params=found.point,
            log_posterior=constant + parameters.log_evidence - len(effects) * float(np.log(len(self.names))),
            parameters=parameters,
        )

    def chosen(self, present: _Present, weights: Weighting) -> Chosen:
        """Return the result about the last model."""
        library, sets = self.look_around(present, weights)
        here = place_of(library)
        probabilities: dict[tuple[str, ...], float] = {}
        for model, probability in sets.probabilities().items():
            key = tuple(sorted(library.candidates[k].name for k in model))
            probabilities[key] = probabilities.get(key, 0.0) + probability
        std, start = {}, 0
        spread = np.sqrt(np.diag(present.parameters.covariance))
        for name in present.effects:
            numbers = [k for k in range(scales((name,)).size) if is_number(name, k)]
            std[name] = np.zeros(scales((name,)).size)
            std[name][numbers] = spread[start : start + len(numbers)] * scales((name,))[numbers]
            start += len(numbers)
        return Chosen(
            params=present.params,
            effects=present.effects,
            probability=probabilities[tuple(sorted(present.effects))],
            sets=dict(sorted(probabilities.items(), key=lambda item: -item[1])),
            inclusion=dict(sorted(sets.inclusion().items(), key=lambda item: -item[1])),
            predictive=predictive(library, sets, here, weights),
            std=std,
            deviation=present.parameters.step[start:],
            weights=weights,
        )


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
    )


def normal_of(library: Library, weights: Weighting, blocks: NDArray[np.int64] | None = None) -> Normal:
    """Return the weighted sums over some blocks, all if None."""
    chosen = slice(None) if blocks is None else blocks
    return Normal(
        product=np.einsum("c,bckl->kl", weights.weight, library.moments.product[chosen]),
        gradient=np.einsum("c,bck->k", weights.weight, library.moments.gradient[chosen]),
    )


def place_of(library: Library) -> Model:
    """Return the set of the candidates that the present model holds."""
    return tuple(k for k, candidate in enumerate(library.candidates) if candidate.named)


def labels(library: Library, model: Model) -> tuple[str, ...]:
    """Return what tells a set from others, whatever the model about which its candidates are linear."""
    found = []
    for candidate in (library.candidates[k] for k in model):
        rotor = EFFECTS.get(candidate.name).parameters[0].kind == "rotor"
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


def predictive(library: Library, sets: Sets, model: Model, weights: Weighting) -> dict[str, Predictive]:
    """Return what each effect of a set adds to the log density of flights left out.

    The density of a flight given the others is the evidence of all flights over that of the others.
    Source: Vehtari, Gelman, Gabry (2017), Practical Bayesian model evaluation, Statistics and Computing 27, section 2
    (difference of log predictive densities, and its standard error).
    """
    fold = folds(library.moments.flight)
    rest = [sets.normal - normal_of(library, weights, np.flatnonzero(fold == label)) for label in np.unique(fold)]

    def densities(of: Model) -> Array:
        whole = posterior(sets.candidates, sets.normal, of).log_evidence
        return np.array([whole - posterior(sets.candidates, part, of).log_evidence for part in rest])

    full, found = densities(model), {}
    for k in model:
        gains = full - densities(tuple(other for other in model if other != k))
        error = float(gains.std(ddof=1) * np.sqrt(gains.size)) if gains.size > 1 else np.inf
        found[library.candidates[k].name] = Predictive(gain=float(gains.sum()), error=error)
    return found
