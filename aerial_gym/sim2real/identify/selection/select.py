"""Which effects the flights ask for: forward selection by flights that are left out, then backward pruning.

An effect is accepted if it predicts flights better that its fit has not seen, if its parameters differ from neutral by
more than noise and the tolerances of the declared vehicle explain, if it matters, and if it makes no channel worse.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import ImuEffect
from aerial_gym.physics.model import check_rotors
from aerial_gym.sim2real.identify.least_squares.covariance import uncertainty, wald_probability
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    Fit,
    Frozen,
    best_within_tolerances,
    fit_effects,
    is_number,
    params_of,
    scales,
    tolerance_jacobian,
    weighting,
)
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.library import columns_of_starts, has_starts
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE, Criteria, Gain, LeftOut, Scored
from aerial_gym.sim2real.identify.selection.screening import Screening
from aerial_gym.sim2real.identify.selection.structure import find_structure
from aerial_gym.sim2real.identify.selection.surrogates import SurrogateTest
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import KINEMATIC
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.replay.rotor_commands import missing_in_logs, too_steady
from aerial_gym.sim2real.predict.scene import lacks_of_scene
from aerial_gym.sim2real.progress import Progress

Array = NDArray[np.float64]
USUAL_ROUNDS = 4
"""For the estimate of the time left."""

MOST_FITTED = 6
"""Effects that are fitted in a round; the others gain less at first sight."""

MOST_STARTS = 3
"""Starts from which an effect is fitted that has several, the best first: a pendulum has many lengths that look alike."""

MOST_PAIRS = 6
"""Pairs that are tried where no effect holds alone."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One candidate tried on top of the effects accepted before."""

    effect: str
    scored: Scored | None
    """None if it cannot be tested."""

    gain: Gain | None = None
    """On flights left out."""

    probability: float = 1.0
    """That noise and tolerances alone show such parameters."""

    objections: tuple[str, ...] = ()
    """Why it is not accepted; empty if it may be."""

    screened: Gain | None = None
    """Of an effect that was not fitted: what it would gain if the model were linear in it."""

    only_harms: bool = False
    """Whether the only objection is that a channel gets worse."""

    @property
    def num_free(self) -> int:
        """Return how many parameters of the effect the fit could choose."""
        if self.scored is None:
            return 0
        own = set(self.scored.fit.columns_of(self.effect).tolist())
        return len(own & set(self.scored.fit.free_effects.tolist()))

    @property
    def complexity(self) -> int:
        """Return by what effects are ordered that flights do not tell apart: free parameters, wider cases behind."""
        return self.num_free + len(EFFECTS.get(self.effect).contains)

    @property
    def label(self) -> str:
        """Return the name of the effect, with its rotor if it has one."""
        parameters = EFFECTS.get(self.effect).parameters
        if self.scored is None or parameters[0].kind != "rotor":
            return self.effect
        return f"{self.effect} of rotor {self.scored.fit.point.effects[self.effect][0]:.0f}"

    @property
    def summed(self) -> "Trial":
        """Return the trial with the sums over all its blocks in place of those of each: some per cent of the memory."""
        return self if self.scored is None else replace(self, scored=self.scored.summed)

    @property
    def score(self) -> float:
        """Return the gain in log likelihood, minus infinity if it cannot be tested."""
        return -np.inf if self.gain is None else self.gain.score


@dataclass(frozen=True, kw_only=True)
class Selection:
    """The course and the result of the selection."""

    declared: Scored
    final: Scored
    accepted: tuple[str, ...]
    """In the order in which they were named."""

    acceptance: dict[str, Trial]
    """The trial with which each accepted effect was accepted."""

    rounds: tuple[tuple[Trial, ...], ...]
    """Trials of each round, best score first; the last one accepts nothing."""

    rivals: dict[str, tuple[Trial, ...]]
    """Beside each accepted effect: others in its place; positive score: better than it."""

    not_testable: dict[str, str]
    """Effects that these flights cannot show, and why."""

    surrogates: dict[str, str]
    """Effects that only stand in for a structure that no effect has, and for which."""

    left_out: LeftOut
    weights: Weighting
    criteria: Criteria


def select_effects(
    predictor: Predictor, declared: ModelParams, criteria: Criteria, progress: Progress, *, test: Sequence[Flight] = ()
) -> Selection:
    """Return the effects that the training flights ask for, on top of the declared model.

    Effects that a log of ``test`` has not what they need for are left out; nothing else is taken from those flights.
    """
    return _Selector(predictor, declared, criteria, progress, test).run()


class _Selector:
    """Holds what the trials share."""

    def __init__(
        self,
        predictor: Predictor,
        declared: ModelParams,
        criteria: Criteria,
        progress: Progress,
        test: Sequence[Flight],
    ) -> None:
        self.predictor, self.declared, self.criteria, self.progress = predictor, declared, criteria, progress
        self.candidates = tuple(name for name in EFFECTS if not EFFECTS.get(name).random)
        reasons = {name: lacks(name, predictor.robot, predictor.flights, test) for name in self.candidates}
        self.lacking = {name: reason for name, reason in reasons.items() if reason}
        self.tolerance = tolerance_jacobian(predictor, declared, predictor.predict(declared))
        able = [name for name in self.candidates if name not in self.lacking]
        several = [name for name in able if has_starts(name, predictor.robot) and name not in declared.effects]
        common = tuple(name for name in able if not has_starts(name, predictor.robot))
        beside = columns_of_starts(predictor, declared, declared, several, self.tolerance)
        self.weights = weighting(predictor, declared, common, beside)
        squares = np.concatenate([(part**2).sum(axis=2) for part in self.tolerance])
        self.left_out = LeftOut(
            moments=self._fit((), declared, frozenset()).moments,
            weights=self.weights,
            criteria=criteria,
            channels=predictor.channels,
            tolerated=np.sqrt(squares.mean(axis=0)),
        )

    def run(self) -> Selection:
        """Select, prune, weigh the rivals."""
        declared = current = self.score((), self.declared)
        rounds: list[tuple[Trial, ...]] = []
        acceptance: dict[str, Trial] = {}
        while len(rounds) <= 2 * len(self.candidates):  # pruning could in principle go in a circle
            trials = self.try_all(current, len(rounds))
            rounds.append(tuple(trial.summed for trial in trials))
            passed = [trial for trial in trials if not trial.objections]
            chosen = self.simplest(passed) or self.best_pair(trials, current)
            if not chosen:
                break
            acceptance |= {trial.effect: trial.summed for trial in chosen}
            assert chosen[0].scored is not None
            current = self.prune(chosen[0].scored, newest={trial.effect for trial in chosen})
            current = self.within_bounds(self.linearise_tolerances(current))
        current, surrogates = self.without_surrogates(current)
        untestable = {t.effect: t.objections[0] for t in rounds[-1] if t.scored is None and t.screened is None}
        rivals = {name: self.weigh_rivals(name, current) for name in current.effects}
        for trial in (trial for trials in rivals.values() for trial in trials):
            untestable.pop(trial.effect, None)  # hidden only beside the effect that it could replace
        return Selection(
            declared=declared,
            final=current,
            accepted=current.effects,
            acceptance=acceptance,
            rounds=tuple(rounds),
            rivals=rivals,
            not_testable=untestable,
            surrogates=surrogates,
            left_out=self.left_out,
            weights=self.weights,
            criteria=self.criteria,
        )

    def try_all(self, current: Scored, done: int) -> list[Trial]:
        """Return every effect that is not in the model, tried on top of it, best score first."""
        return self.try_each([name for name in self.candidates if name not in current.effects], current, done)

    def try_each(self, names: Sequence[str], current: Scored, done: int | None = None, fewest: int = 0) -> list[Trial]:
        """Return trials of some effects on top of a model, best score first.

        Every effect is screened as if the model were linear in it; those that then look best are fitted, ``fewest`` of them
        even if they seem to gain nothing. Outside of a round (``done`` is None) each from its best start alone.
        """
        screening = Screening(self.predictor, current, self.tolerance, self.left_out)
        trials, screened, starts = [], [], {}
        for count, name in enumerate(names):
            if done is not None:
                share = (done + 0.5 * count / len(names)) / USUAL_ROUNDS
                self.progress(f"round {done + 1}: {name}", min(1.0, share))
            if name in self.lacking:
                trials.append(Trial(effect=name, scored=None, objections=(self.lacking[name],)))
                continue
            points = self.points(name, current.fit.point)
            options = [screening.screen(name, start, current.fit.frozen) for start in points]
            options.sort(key=lambda candidate: (candidate.unidentified, -candidate.gain.score))
            screened.append(options[0])
            on_a_rotor = EFFECTS.get(name).parameters[0].kind == "rotor"  # then another start is another effect
            starts[name] = [option.start for option in options[: 1 if on_a_rotor or done is None else MOST_STARTS]]
        screened.sort(key=lambda candidate: -candidate.gain.score)
        seen = [candidate for candidate in screened if not candidate.unidentified]
        worth = [one for place, one in enumerate(seen[:MOST_FITTED]) if place < fewest or one.gain.score > 0.0]
        for count, candidate in enumerate(worth):
            if done is not None:
                share = (done + 0.5 + 0.5 * count / len(worth)) / USUAL_ROUNDS
                self.progress(f"round {done + 1}: {candidate.effect}", min(1.0, share))
            tried = [self.try_from(candidate.effect, current, start) for start in starts[candidate.effect]]
            trials.append(max(tried, key=lambda trial: trial.score))
        for candidate in screened:
            if candidate.unidentified:
                reason = f"these flights do not show it; needed: {EFFECTS.get(candidate.effect).excitation}"
                trials.append(Trial(effect=candidate.effect, scored=None, objections=(reason,)))
            elif candidate not in worth:
                reason = "gains nothing" if candidate.gain.score <= 0.0 else "gains less than others at first sight"
                trials.append(
                    Trial(effect=candidate.effect, scored=None, screened=candidate.gain, objections=(reason,))
                )
        return sorted(trials, key=lambda trial: -trial.score)

    def simplest(self, passed: list[Trial]) -> list[Trial]:
        """Return the trial with the fewest parameters among the best one and those that it does not clearly beat.

        So a cause is not given the name of a family that contains it. ``passed`` comes best score first.
        """
        if not passed:
            return []
        best = passed[0].scored
        assert best is not None
        tied = [passed[0]]
        for trial in passed[1:]:
            assert trial.scored is not None
            ahead = self.compare(trial.scored, best)
            if ahead.p_value > self.criteria.rival_significance or ahead.score < LEAST_SCORE:
                tied.append(trial)
        return [min(tied, key=lambda trial: trial.complexity)]  # the first, and so the best, of equals

    def neutral(self, name: str) -> Array:
        """Return the parameters with which an effect changes nothing: declared ones, else its neutral ones."""
        if name in self.declared.effects:
            return self.declared.effects[name]
        return np.array(EFFECTS.get(name).neutral(self.predictor.robot), dtype=float)

    def points(self, name: str, here: ModelParams) -> list[ModelParams]:
        """Return where fits of an effect on top of a model start."""
        if name in here.effects:
            return [here]
        if name in self.declared.effects:
            return [here.with_effect(name, self.neutral(name))]
        starts = EFFECTS.get(name).starts(self.predictor.robot)
        return [here.with_effect(name, np.array(start)) for start in starts]

    def _fit(self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen) -> Fit:
        return fit_effects(self.predictor, effects, start, self.tolerance, self.weights.weight, frozen=frozen)

    def score(self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen = frozenset()) -> Scored:
        """Return the model with these effects fitted, and its squares on flights left out."""
        fit = self._fit(effects, start, frozen)
        return Scored(fit=fit, spread=uncertainty(fit, self.weights.weight), left_out=self.left_out.squares(fit))

    def linearise_tolerances(self, current: Scored) -> Scored:
        """Return the model with the tolerances taken around it: what a mass does depends on the drag."""
        point = current.fit.point
        self.tolerance = tolerance_jacobian(self.predictor, point, self.predictor.predict(point))
        return self.score(current.effects, point, current.fit.frozen)

    def try_from(self, name: str, current: Scored, start: ModelParams) -> Trial:
        """Return how one more effect does from some parameters on."""
        effects, frozen = (*current.effects, name), current.fit.frozen
        scored = self.score(effects, start, frozen)
        unidentified = {owner for owner in unidentified_parameters(scored) if owner[0] == name}
        numbers = sum(is_number(name, place) for place in range(len(EFFECTS.get(name).parameters)))
        if (
            0 < len(unidentified) < numbers
        ):  # what is nothing at neutral may show where the fit has gone: a power of no wind
            scored = self.score(effects, scored.fit.point, frozen)
            unidentified = {owner for owner in unidentified_parameters(scored) if owner[0] == name}
        if len(unidentified) == numbers:
            reason = f"these flights do not show it; needed: {EFFECTS.get(name).excitation}"
            return Trial(effect=name, scored=None, objections=(reason,))
        if unidentified:
            scored = self.score(effects, start, frozen | unidentified)
        return self.judge(name, current, scored)

    def judge(self, name: str, current: Scored, scored: Scored) -> Trial:
        """Return the trial with every objection to accepting the effect."""
        gain = self.left_out.gain_beyond_tolerances(current, scored)
        probability = self.probability_neutral(name, scored)
        objections = self.left_out.objections(gain)
        objections += [
            f"{parameter} runs into its physical bound"
            for parameter in at_bounds(name, scored.fit, self.neutral(name), self.predictor.robot)
        ]
        if probability > self.criteria.significance:
            objections.insert(0, f"parameters within noise and tolerances (p = {probability:.2g})")
        return Trial(
            effect=name,
            scored=scored,
            gain=gain,
            probability=probability,
            objections=tuple(objections),
            only_harms=bool(objections) and objections == self.left_out.harms(gain),
        )

    def compare(self, less: Scored, more: Scored) -> Gain:
        """Return the gain of one model over another, with what each asks of the tolerances counted as their prior does.

        A thrust scale and a mass explain forces alike; the wrong one needs an inertia that is off by several deviations.
        """
        gain, saved = self.left_out.gain(less.left_out, more.left_out), less.penalty - more.penalty
        return replace(
            gain, score=gain.score + saved, p_value=float(min(1.0, gain.p_value * np.exp(min(-saved, 700.0))))
        )

    def probability_neutral(self, name: str, scored: Scored) -> float:
        """Return the probability that an effect's parameters are neutral, given noise and tolerances."""
        fit, spread = scored.fit, scored.spread
        places = [i for i, k in enumerate(spread.columns) if k in fit.columns_of(name)]
        neutral = np.concatenate([self.neutral(effect) for effect in fit.effects])
        distance = (params_of(fit.point, fit.effects) - neutral) / scales(fit.effects)
        distance = distance + spread.step[: fit.num_effect_params]
        return wald_probability(distance[spread.columns[places]], spread.part(places))

    def without(self, scored: Scored, name: str) -> Scored:
        """Return the model with one effect taken back to neutral and the others fitted again."""
        effects = {key: params for key, params in scored.fit.point.effects.items() if key != name}
        if name in self.declared.effects:
            effects[name] = self.declared.effects[name]
        kept = tuple(effect for effect in scored.effects if effect != name)
        start = ModelParams(effects=effects, learned=self.declared.learned)
        return self.score(kept, start, frozenset(f for f in scored.fit.frozen if f[0] != name))

    def best_pair(self, trials: list[Trial], current: Scored) -> list[Trial]:
        """Return two effects that stand in each other's way alone, and hold together; empty if there are none.

        Alone, one makes a channel worse that the other would mend. Together, each must pass beside the other.
        """
        fitted = [trial for trial in trials if trial.scored is not None]
        pairs = [(one, other) for one, other in combinations(fitted, 2) if one.only_harms or other.only_harms]
        found: list[list[Trial]] = []
        for one, other in sorted(pairs, key=lambda pair: -pair[0].score - pair[1].score)[:MOST_PAIRS]:
            assert one.scored is not None
            both = max(
                (
                    self.try_from(other.effect, one.scored, point)
                    for point in self.points(other.effect, one.scored.fit.point)
                ),
                key=lambda trial: trial.score,
            )
            if both.scored is None or both.objections:
                continue
            again = self.judge(one.effect, self.without(both.scored, one.effect), both.scored)
            if not again.objections:
                gain = self.left_out.gain(current.left_out, both.scored.left_out)
                found.append([replace(again, gain=gain), replace(both, gain=gain)])
        return max(found, key=lambda pair: pair[0].score, default=[])

    def within_bounds(self, scored: Scored) -> Scored:
        """Return the model without effects that the last fit drove into a bound; they are not tried again."""
        for name in scored.effects:
            ends = at_bounds(name, scored.fit, self.neutral(name), self.predictor.robot)
            if ends:
                self.lacking[name] = f"runs into its physical bound beside the other effects: {', '.join(ends)}"
                return self.within_bounds(self.without(scored, name))
        return scored

    def without_surrogates(self, scored: Scored) -> tuple[Scored, dict[str, str]]:
        """Return the model without effects that only stand in for a structure of what remains, and that structure for each.

        A force that depends on position has a mean, and that mean looks like a wind; a thrust that fades has a mean loss.
        """
        flights, times, channels = self.predictor.flights, self.predictor.times, self.predictor.channels
        dynamic = [place for place, channel in enumerate(channels) if channel.kind not in KINEMATIC]
        surrogates: dict[str, str] = {}
        while scored.effects:
            residuals = self.within_tolerances(scored)
            structure = find_structure(flights, times, residuals, channels, dynamic)
            if structure.kind == "none":
                break
            among = SurrogateTest(structure, flights, times, channels, self.weights, residuals)
            less = {name: self.within_tolerances(self.without(scored, name)) for name in scored.effects}
            neutral = {name: self.neutral(name) for name in scored.effects}
            found = [n for n in scored.effects if among.is_surrogate(n, scored.fit, neutral[n], less[n])]
            if not found:
                break
            surrogates[found[-1]] = structure.kind
            scored = self.without(scored, found[-1])
        return scored, surrogates

    def within_tolerances(self, scored: Scored) -> list[Array]:
        """Return the residuals of a model with the deviations within the tolerances that fit best, (rows, C) each."""
        point = best_within_tolerances(self.predictor.robot, scored.fit, self.weights.weight)
        return self.predictor.residuals(point)

    def prune(self, scored: Scored, *, newest: set[str]) -> Scored:
        """Return the model without effects that the newest have made superfluous: what no longer pays, not what also harms."""
        for name in [effect for effect in scored.effects if effect not in newest]:
            less = self.without(scored, name)
            trial = self.judge(name, less, scored)
            if trial.objections and not trial.only_harms:
                scored = less
        return scored

    def weigh_rivals(self, name: str, final: Scored) -> tuple[Trial, ...]:
        """Return every other effect in the place of an accepted one, best first.

        Their gain is over the final model; its p-value: that the final model is no better than they are.
        """
        less, trials = self.without(final, name), []
        others = [n for n in self.candidates if n not in final.effects and n not in self.lacking]
        for trial in self.try_each(others, less, fewest=1):
            if trial.scored is not None:
                gain, back = self.compare(final, trial.scored), self.compare(trial.scored, final)
                trials.append(replace(trial.summed, gain=replace(gain, p_value=back.p_value)))
        return tuple(sorted(trials, key=lambda trial: -trial.score))


def lacks(name: str, robot: RobotCfg, train: Sequence[Flight], test: Sequence[Flight] = ()) -> str:
    """Return what robot file or logs lack for an effect; empty if nothing."""
    effect, flights = EFFECTS.get(name), [*train, *test]
    if effect.kind is ImuEffect and not any(flight.accelerometer or flight.gyro for flight in train):
        return "the logs hold no inertial sensor: forces are derived from the velocity"
    if reason := missing_in_logs(effect, flights) or lacks_of_scene(name, flights) or too_steady(effect, train):
        return reason
    try:
        check_rotors(effect, robot.rotor_traits)
        effect.check(robot)
    except ConfigError as error:
        return str(error)
    return ""


def at_bounds(name: str, fit: Fit, neutral: Array, robot: RobotCfg) -> list[str]:
    """Return the parameters of an effect that end at a bound that is not neutral: the cause is another one."""
    effect, found = EFFECTS.get(name), []
    rows = zip(effect.parameters, effect.bounds(robot), fit.point.effects[name], neutral, strict=True)
    for parameter, bounds, value, start in rows:
        near = 1e-3 * parameter.scale
        ends = [bound for bound in bounds if abs(value - bound) <= near]
        if parameter.kind == "number" and ends and abs(start - ends[0]) > near:
            found.append(parameter.name)
    return found


def unidentified_parameters(scored: Scored) -> set[tuple[str, int]]:
    """Return the fitted parameters, effect and place, that the flights leave unknown by more than their scale."""
    owners = scored.fit.owners
    return {owners[k] for k in scored.fit.free_effects[np.diag(scored.spread.plain) > 1.0]}
