"""Design of experiments: the manoeuvre that distinguishes tied effects, or shows an effect that no flight has shown.

The declared vehicle flies every manoeuvre of the catalogue in simulation, with the noise of the given flights. One model is
taken as true, and another is fitted to its prediction together with the tolerances. The expected score is the loss in log
likelihood of that fit: half the weighted squares that remain. It generalises the Fisher information: the true model's
prediction is exact, and only the fitted model is linear.
Letters: M manoeuvres.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects.arm_joint import ArmJoint
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import starts_of_effect
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    effect_jacobian,
    is_continuous_parameter,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    ModelFit,
    fit_of_moments,
    least_squares_step_in_bounds,
    normal_equations_without_prior,
    prior_precision,
)
from aerial_gym.sim2real.identify.least_squares.moments import block_moments
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.select import Rival, SelectionResult
from aerial_gym.sim2real.identify.stages import LoopSetup
from aerial_gym.sim2real.judge.experiments.manoeuvres import MANOEUVRES, SPAN_S, manoeuvre_flight
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rows.dataset import ROWS_PER_BAND

SLOWEST_HZ = 100.0  # Least rate of a manoeuvre's rows [Hz]


@dataclass(frozen=True, kw_only=True)
class Advice:
    """The best manoeuvre for one question, with its expected score."""

    fly: str | None  # Name of the manoeuvre; None if none of the catalogue reaches ``LEAST_SCORE``
    tells: tuple[str, ...]  # Effects that it distinguishes, or the one that it shows
    score: float  # Expected gain in log likelihood per 10 s of the best manoeuvre, even if it is too small
    hover: float  # The same in hover, for comparison

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {"fly": self.fly, "tells": list(self.tells), "expected_score_per_10s": self.score}

    @property
    def finding(self) -> Finding:
        """Return the next step: the manoeuvre, or a measurement on the bench."""
        tells = {"tells": list(self.tells)}
        return Finding("weigh_or_log", "", tells) if self.fly is None else Finding("fly", self.fly, tells)


class ManoeuvreCatalogue:
    """The manoeuvres that a vehicle can fly, with the sensors and the noise of the given flights."""

    def __init__(self, train: Predictor, selection: SelectionResult) -> None:
        """Take the predictor of the training flights; the first flight states which sensors are logged."""
        rate = max(SLOWEST_HZ, ROWS_PER_BAND * train.bandwidth)
        flights = [manoeuvre_flight(name, train.robot, train.flights[0], rate=rate) for name in MANOEUVRES]
        self.flights = [flight for flight in flights if flight is not None]
        self.predictor = Predictor(
            train.robot, self.flights, bandwidth=train.bandwidth, channels=train.channels, tolerances=train.tolerances
        )
        self.weight = selection.weights.weight
        self._tolerance = tolerance_jacobian(self.predictor, selection.fit.params)
        self._spans = np.array([SPAN_S / float(time[-1] - time[0]) for time in self.predictor.times])

    def score_of_pair(self, one: tuple[ModelParams, Sequence[str]], other: tuple[ModelParams, Sequence[str]]) -> Array:
        """Return the smaller expected score per 10 s of the two cases in which either model is true, (M,).

        Each model is given by its parameters and the names of the effects that may be fitted.
        """
        return np.minimum(self.likelihood_losses(one[0], *other), self.likelihood_losses(other[0], *one))

    def likelihood_losses(self, truth: ModelParams, fitted: ModelParams, effects: Sequence[str]) -> Array:
        """Return the expected loss in log likelihood per 10 s of a fitted model against the true one, (M,)."""
        fit = self._linear_fit(self.predictor.predict(truth), fitted, tuple(effects))
        scores = []
        for index in range(len(self.flights)):
            blocks = np.flatnonzero(fit.moments.flight == index)
            step = least_squares_step_in_bounds(fit, self.weight, fit.indices_of_fitted_params, blocks)
            squares = fit.moments.block_squares(np.tile(step, (fit.moments.flight.size, 1)))[blocks].sum(axis=0)
            scores.append(0.5 * float(self.weight @ squares + prior_precision(fit) @ step**2))
        return np.multiply(np.maximum(scores, 0.0), self._spans)

    def score_of_effect(self, name: str, final: ModelParams, effects: Sequence[str], declared: ModelParams) -> Array:
        """Return the expected score per 10 s of a moderate effect over none in each manoeuvre, (M,).

        Its best-determined parameter has a change of one scale. Other effects and the tolerances are fitted too.
        """
        params = starts_of_effect(name, final, declared, self.predictor.robot)[0]
        fit = self._linear_fit(self.predictor.predict(params), params, (*effects, name))
        own = [k for k in fit.indices_of_effect(name) if is_continuous_parameter(*fit.parameter_owners[k])]
        scores = []
        for index in range(len(self.flights)):
            product, _ = normal_equations_without_prior(fit, self.weight, np.flatnonzero(fit.moments.flight == index))
            free = fit.indices_of_fitted_params
            spread = np.linalg.inv(product[np.ix_(free, free)] + np.diag(prior_precision(fit)[free]))
            best = min(spread[place, place] for place, k in enumerate(free) if k in own)
            scores.append(0.5 / best)
        return np.multiply(scores, self._spans)

    def _linear_fit(self, truth: list[Array], params: ModelParams, effects: tuple[str, ...]) -> ModelFit:
        base = self.predictor.predict(params)
        own = effect_jacobian(self.predictor, params, effects, base)
        jacobians = [np.concatenate(pair, axis=2) for pair in zip(own, self._tolerance, strict=True)]
        moments = block_moments(self.predictor.times, [t - b for t, b in zip(truth, base, strict=True)], jacobians)
        return fit_of_moments(self.predictor.robot, effects, params, moments)

    def best_advice(self, scores: Array, tells: tuple[str, ...]) -> Advice:
        """Return the manoeuvre with the highest score; without a name if that is below ``LEAST_SCORE``."""
        best = int(np.argmax(scores))
        name = self.flights[best].name if scores[best] >= LEAST_SCORE else None
        still = next((place for place, flight in enumerate(self.flights) if flight.name == "hover"), best)
        return Advice(fly=name, tells=tells, score=float(scores[best]), hover=float(scores[still]))


def manoeuvre_for_ties(
    catalogue: ManoeuvreCatalogue, selection: SelectionResult, tied: dict[str, list[Rival]]
) -> Advice | None:
    """Return the manoeuvre whose lowest score over all tied pairs is highest; None if there are none.

    ``tied`` has the rivals of each accepted effect that fit the flights equally well.
    """
    fit, scores, names = selection.fit, [], []
    for name, rivals in tied.items():
        for rival in rivals:
            other = rival.fitted
            scores.append(catalogue.score_of_pair((fit.params, fit.effects), (other.params, other.effects)))
            names += [name, rival.effect]
    return catalogue.best_advice(np.min(scores, axis=0), tuple(dict.fromkeys(names))) if scores else None


def effects_to_show(selection: SelectionResult, robot: RobotCfg, flights: Sequence[Flight]) -> list[str]:
    """Return the effects that these flights do not show, but other flights of this vehicle could."""
    unseen = [name for name in selection.not_testable if name not in selection.effect_names]
    possible = (name for name in unseen if not finding_on_untestable_effect(name, robot, flights))
    return [name for name in possible if can_have_effect(name, selection, robot)]


def can_have_effect(name: str, selection: SelectionResult, robot: RobotCfg) -> bool:
    """Return whether a vehicle may have an effect; soft arms need such an effect in its file or among the named ones."""
    if not isinstance(EFFECTS.get(name), ArmJoint):
        return True
    return any(isinstance(EFFECTS.get(other), ArmJoint) for other in (*robot.effects, *selection.effect_names))


def recommend_manoeuvres(
    declared: LoopSetup, selection: SelectionResult, open_to: Sequence[str]
) -> tuple[Advice | None, dict[str, Advice]]:
    """Return the manoeuvre that distinguishes tied effects, and one for each effect that the flights do not show.

    ``open_to`` names effects that would explain the test residual and that training flights do not show.
    """
    train = declared.train
    tied = {name: selection.effect_ties(name) for name in selection.effect_names}
    hidden = list(dict.fromkeys((*effects_to_show(selection, train.robot, train.flights), *open_to)))
    if not any(tied.values()) and not hidden:
        return None, {}
    catalogue, fit = ManoeuvreCatalogue(train, selection), selection.fit
    shows = {}
    for name in hidden:
        score = catalogue.score_of_effect(name, fit.params, fit.effects, declared.params)
        shows[name] = catalogue.best_advice(score, (name,))
    tells = manoeuvre_for_ties(catalogue, selection, tied)
    return tells or next((shows[name] for name in open_to), None), shows
