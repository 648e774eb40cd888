"""Which effects the flights ask for: forward selection by flights that are left out, then backward pruning.

An effect is accepted if it predicts flights better that its fit has not seen, if its parameters differ from neutral by
more than noise and the tolerances of the declared vehicle explain, and if it matters. Letters: B blocks, C channels.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.fit import (
    Fit,
    Weighting,
    best_step,
    fit_effects,
    params_of,
    scales,
    tolerance_jacobian,
    weighting,
)
from aerial_gym.sim2real.prediction import Point, Predictor
from aerial_gym.sim2real.stand_ins import SENSOR_STAND_INS, stand_ins
from aerial_gym.sim2real.uncertainty import Uncertainty, uncertainty, wald_probability

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Told what is being done and which share of the work is done."""


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """When an effect is accepted."""

    significance: float = 0.001
    """Largest probability that noise and tolerances alone show such parameters."""

    left_out_significance: float = 0.01
    """Largest probability that the gain on flights left out is chance."""

    flights_better: float = 0.75
    """Least share of flights left out that it must predict better, and that it must not harm in any channel."""

    material: float = 0.05
    """Least relative fall of the left-out residual (rms) in its best channel."""

    visible: float = 0.5
    """What it takes off that channel must be this share of what the tolerances of the vehicle may add there."""

    harmless: float = 0.02
    """Largest relative rise of the left-out residual (rms) of a channel that is no harm."""

    rival_significance: float = 0.01
    """Rivals whose left-out gain differs from the accepted effect's with less certainty cannot be told apart."""


@dataclass(frozen=True, kw_only=True)
class Scored:
    """A fitted model and how it predicts flights that it has not seen."""

    fit: Fit
    spread: Uncertainty
    left_out: Array
    """Sums of squares of each block, predicted by the fit without its flight, (B, C)."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the fitted effects."""
        return self.fit.effects

    def rms(self) -> Array:
        """Return the left-out residual of each channel, (C,)."""
        return np.sqrt(self.left_out.sum(axis=0) / self.fit.moments.count.sum())


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What one model gains over another on flights left out."""

    score: float
    """In log likelihood."""

    chance: float
    """Probability that it is chance."""

    flights_better: float
    """Share of the flights that are predicted better."""

    falls: tuple[float, ...]
    """Relative fall of the residual (rms) of each channel, over all flights."""

    harmed: tuple[float, ...]
    """Share of the flights in which the residual of each channel rises."""

    worse: tuple[bool, ...]
    """Whether the residual of each channel rises over all flights."""

    visible: tuple[bool, ...]
    """Whether what falls in each channel is more than the tolerances of the vehicle may hide."""


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

    doubles: tuple[str, ...] = ()
    """Explanations outside the registered effects that these flights cannot tell from it."""

    as_good: tuple[str, ...] = ()
    """Errors of sensors that do as well, for which it is not accepted."""

    better: tuple[str, ...] = ()
    """Explanations that do better, for which it is not accepted."""

    objections: tuple[str, ...] = ()
    """Why it is not accepted; empty if it may be."""

    only_harms: bool = False
    """Whether the only objection is that another channel gets worse."""

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

    weights: Weighting
    criteria: Criteria


@dataclass
class Selector:
    """Holds what the trials share."""

    predictor: Predictor
    declared: Point
    criteria: Criteria = field(default_factory=Criteria)
    progress: Progress = field(default=lambda stage, share: None)

    def __post_init__(self) -> None:
        self.tolerance = tolerance_jacobian(self.predictor, self.declared, self.predictor.predict(self.declared))
        self.candidates = tuple(EFFECTS)
        rows = sum(part.shape[0] for part in self.tolerance)
        self.tolerated = np.sqrt(sum((part**2).sum(axis=(0, 2)) for part in self.tolerance) / rows)
        """Residual (rms) that the tolerances of the vehicle cause in each channel, (C,)."""
        self.weights = weighting(self.predictor, self.declared, self.candidates, self.tolerance)

    def neutral(self, name: str) -> Array:
        """Return the parameters with which an effect changes nothing: declared ones, else its neutral ones."""
        if name in self.declared.effects:
            return self.declared.effects[name]
        return np.array(EFFECTS.get(name).neutral(self.predictor.robot), dtype=float)

    def run(self) -> Selection:
        """Select, prune, weigh the rivals."""
        declared = current = self.score_model((), self.declared)
        self.moments = declared.fit.moments
        rounds: list[tuple[Trial, ...]] = []
        acceptance: dict[str, Trial] = {}
        most = len(self.candidates)
        while len(rounds) <= 2 * most:  # pruning could in principle go in a circle
            left = [name for name in self.candidates if name not in current.effects]
            trials = []
            for count, name in enumerate(left):
                self.progress(f"round {len(rounds) + 1}: {name}", min(1.0, (len(rounds) + count / most) / 4.0))
                trials.append(self.try_effect(name, current))
            trials.sort(key=lambda trial: -trial.score)
            rounds.append(tuple(trials))
            chosen = next(([trial] for trial in trials if not trial.objections), None) or self.best_pair(trials, current)
            if not chosen:
                break
            acceptance |= {trial.effect: trial for trial in chosen}
            assert chosen[0].scored is not None
            current = self.prune(chosen[0].scored, newest={trial.effect for trial in chosen})
            current = self.linearise_tolerances(current)
        untestable = {t.effect: t.objections[0] for t in rounds[-1] if t.scored is None}
        rivals = {name: self.weigh_rivals(name, current, untestable) for name in current.effects}
        return Selection(
            declared=declared,
            final=current,
            accepted=current.effects,
            acceptance=acceptance,
            rounds=tuple(rounds),
            rivals=rivals,
            not_testable=untestable,
            weights=self.weights,
            criteria=self.criteria,
        )

    def score_model(self, effects: tuple[str, ...], start: Point, frozen: tuple[int, ...] = ()) -> Scored:
        """Return the model with these effects fitted, and its squares on flights left out."""
        fit = fit_effects(self.predictor, effects, start, self.tolerance, self.weights.weight, frozen=frozen)
        return Scored(fit=fit, spread=uncertainty(fit, self.weights.weight), left_out=self.left_out(fit))

    def linearise_tolerances(self, current: Scored) -> Scored:
        """Return the model with the tolerances taken around it: what a mass does depends on the drag."""
        point = current.fit.point
        self.tolerance = tolerance_jacobian(self.predictor, point, self.predictor.predict(point))
        return self.score_model(current.effects, point, current.fit.frozen)

    def best_pair(self, trials: list[Trial], current: Scored) -> list[Trial]:
        """Return two effects that stand in each other's way alone, and hold together; empty if there are none.

        Alone, each makes a channel worse that the other would mend. Together, each must pass beside the other.
        """
        found: list[list[Trial]] = []
        for one, other in combinations([t for t in trials if t.scored is not None], 2):
            if not (one.only_harms or other.only_harms):
                continue
            assert one.scored is not None and other.scored is not None
            both = self.try_effect(other.effect, one.scored)
            if both.scored is None or both.objections:
                continue
            less = self.without(both.scored, one.effect)
            again = self.judge(one.effect, less, both.scored)
            if not again.objections:
                gain = self.gain(current.left_out, both.scored.left_out)
                found.append([replace(again, gain=replace(gain, score=gain.score)), both])
        return max(found, key=lambda pair: pair[0].score, default=[])

    def left_out(self, fit: Fit, released: NDArray[np.int64] | None = None) -> Array:
        """Return the squares (B, C) of each flight under the fit of the others; of each quarter if it is the only one.

        ``released`` tolerances are fitted as well.
        """
        flight = fit.moments.flight
        fold = flight if flight.max() > 0 else np.arange(flight.size) * min(4, flight.size) // flight.size
        free = fit.free_effects if released is None else np.concatenate((fit.free_effects, released))
        steps = np.zeros((flight.size, fit.low.size))
        for left in np.unique(fold):
            steps[fold == left] = best_step(fit, self.weights.weight, free, np.flatnonzero(fold != left), released)
        return fit.moments.squares_after(steps)

    def gain(self, less: Array, more: Array) -> "Gain":
        """Return what one set of left-out squares (B, C) gains over another.

        Score: ``sum n_c / 2 log(MS_less / MS_more)`` over channels with n independent samples; its chance from the same
        sum of each block and the scatter between blocks.
        """
        count, effective, flight = self.moments.count, self.weights.effective, self.moments.flight
        by_flight = [
            self._log_ratio(less[flight == f], more[flight == f], count[flight == f].sum() * effective)
            for f in np.unique(flight)
        ]
        ratio = np.log(np.maximum(less, 1e-300) / np.maximum(more, 1e-300))
        blocks = (0.5 * count[:, None] * effective * ratio).sum(axis=1)
        spread = blocks.std(ddof=1) / np.sqrt(blocks.size) if blocks.size > 1 else np.inf
        return Gain(
            score=self._log_ratio(less, more, count.sum() * effective),
            chance=float(stats.t.sf(blocks.mean() / max(spread, 1e-300), max(blocks.size - 1, 1))),
            flights_better=float(np.mean([g > 0.0 for g in by_flight])),
            falls=tuple(1.0 - np.sqrt(more.sum(axis=0) / np.maximum(less.sum(axis=0), 1e-300))),
            harmed=tuple(
                np.mean(
                    [self._rises(less[flight == f], more[flight == f], count[flight == f]) for f in np.unique(flight)],
                    axis=0,
                )
            ),
            worse=tuple(self._rises(less, more, count)),
            visible=tuple((less - more).sum(axis=0) / count.sum() > (self.criteria.visible * self.tolerated) ** 2),
        )

    def _rises(self, less: Array, more: Array, rows: Array) -> NDArray[np.bool_]:
        """Return in which channels squares (B, C) rise by more than is harmless and than tolerances may cause, (C,)."""
        before, after = less.sum(axis=0) / rows.sum(), more.sum(axis=0) / rows.sum()
        return (after > (1.0 + self.criteria.harmless) ** 2 * before) & (after - before > self.tolerated**2)

    @staticmethod
    def _log_ratio(less: Array, more: Array, samples: Array) -> float:
        ratio = np.maximum(less.sum(axis=0), 1e-300) / np.maximum(more.sum(axis=0), 1e-300)
        return float((0.5 * samples * np.log(ratio)).sum())

    def try_effect(self, name: str, current: Scored) -> Trial:
        """Return how one more effect does on top of the accepted ones."""
        start = current.fit.point
        if name not in start.effects:
            start = start.with_effect(name, self.neutral(name))
        effects = (*current.effects, name)
        scored = self.score_model(effects, start, current.fit.frozen)
        own = scored.fit.columns_of(name)
        blind = self.blind_parameters(scored)
        if all(k in blind for k in own):
            return Trial(
                effect=name,
                scored=None,
                objections=(f"these flights do not show it; needed: {EFFECTS.get(name).excitation}",),
            )
        if blind:
            scored = self.score_model(effects, start, (*current.fit.frozen, *blind))
        trial = self.judge(name, current, scored)
        return trial if trial.objections else self.weigh_stand_ins(trial, current, scored)

    @staticmethod
    def blind_parameters(scored: Scored) -> tuple[int, ...]:
        """Return the fitted parameters that the flights leave unknown by more than their scale."""
        variance = np.diag(scored.spread.plain) + np.diag(scored.spread.tolerance)
        return tuple(int(k) for k in scored.fit.free_effects[variance > 1.0])

    def judge(self, name: str, current: Scored, scored: Scored) -> Trial:
        """Return the trial with every objection to accepting the effect."""
        gain = self.gain(current.left_out, scored.left_out)
        probability = self.probability_neutral(name, scored)
        objections = self.objections_to(gain)
        harms = len(objections) == 1 and (any(gain.worse) or max(gain.harmed) > 1.0 - self.criteria.flights_better)
        if probability > self.criteria.significance:
            objections.insert(0, f"parameters within noise and tolerances (p = {probability:.2g})")
        return Trial(
            effect=name,
            scored=scored,
            gain=gain,
            probability=probability,
            objections=tuple(objections),
            only_harms=harms and probability <= self.criteria.significance,
        )

    def objections_to(self, gain: "Gain") -> list[str]:
        """Return why a gain on flights left out does not count."""
        rules, objections = self.criteria, []
        if gain.chance > rules.left_out_significance:
            objections.append(f"gain on flights left out may be chance (p = {gain.chance:.2g})")
        if gain.flights_better < rules.flights_better:
            objections.append(f"predicts only {gain.flights_better:.0%} of the flights left out better")
        if max(fall * seen for fall, seen in zip(gain.falls, gain.visible, strict=True)) < rules.material:
            objections.append(f"takes at most {max(*gain.falls, 0.0):.1%} off a residual")
        channels = self.predictor.channels
        if any(gain.worse):
            worst = int(np.argmin(np.where(gain.worse, gain.falls, np.inf)))
            objections.append(f"makes {channels[worst].name} worse by {-gain.falls[worst]:.1%}")
        elif max(gain.harmed) > 1.0 - rules.flights_better:
            worst = channels[int(np.argmax(gain.harmed))].name
            objections.append(f"makes {worst} worse in {max(gain.harmed):.0%} of the flights left out")
        return objections

    def weigh_stand_ins(self, trial: Trial, current: Scored, scored: Scored) -> Trial:
        """Return the trial with explanations that cannot be told from the effect, and objections from better ones.

        The effect is fitted together with the tolerances that an explanation sets free. It is superfluous if it is then
        no longer significant. Then the explanation does better if what it sets free lies outside its tolerance and matters;
        the error of a sensor does as well if the effect is not clearly better in its place.
        """
        rules = self.criteria
        doubles, as_good, better = [], [], []
        names = self.predictor.tolerances.names(self.predictor.robot.num_rotors)
        for name, places in stand_ins(names).items():
            released = places + scored.fit.num_effect_params
            if self.probability_neutral(trial.effect, scored, released) < rules.significance:
                continue
            more = self.left_out(scored.fit, released)
            instead = self.left_out(current.fit, places + current.fit.num_effect_params)
            outside = self.probability_within(scored, released) < rules.significance
            if outside and not self.objections_to(self.gain(scored.left_out, more)):
                better.append(name)
            elif name in SENSOR_STAND_INS and self.gain(instead, scored.left_out).chance > rules.rival_significance:
                as_good.append(name)
            else:
                doubles.append(name)
        objections = [f"{name} explains the flights better" for name in better]
        objections += [f"{name} explains the flights as well" for name in as_good]
        return replace(
            trial,
            doubles=tuple(doubles),
            as_good=tuple(as_good),
            better=tuple(better),
            objections=(*trial.objections, *objections),
        )

    def probability_neutral(self, name: str, scored: Scored, released: NDArray[np.int64] | None = None) -> float:
        """Return the probability that an effect's parameters are neutral, given noise and tolerances."""
        fit, own = scored.fit, set(scored.fit.columns_of(name).tolist())
        spread = scored.spread if released is None else uncertainty(fit, self.weights.weight, released)
        places = [i for i, k in enumerate(spread.columns) if k in own]
        neutral = np.concatenate([self.neutral(effect) for effect in fit.effects])
        distance = (params_of(fit.point, fit.effects) - neutral) / scales(fit.effects)
        distance = distance + spread.step[: fit.num_effect_params]
        return wald_probability(distance[spread.columns[places]], spread.part(places))

    def probability_within(self, scored: Scored, released: NDArray[np.int64]) -> float:
        """Return the probability of tolerances set free lying where they do, if they are as stated."""
        spread = uncertainty(scored.fit, self.weights.weight, released)
        places = [i for i, k in enumerate(spread.columns) if k in released]
        part = spread.part(places)
        return wald_probability(
            spread.step[released], replace(part, tolerance=part.tolerance + np.eye(len(places)))
        )

    def without(self, scored: Scored, name: str) -> Scored:
        """Return the model with one effect taken back to neutral and the others fitted again."""
        kept = tuple(effect for effect in scored.effects if effect != name)
        effects = dict(scored.fit.point.effects)
        del effects[name]
        if name in self.declared.effects:
            effects[name] = self.declared.effects[name]
        named = {(e, int(k - scored.fit.columns_of(e)[0])) for e in kept for k in scored.fit.frozen if k in scored.fit.columns_of(e)}
        point = Point(effects=effects)
        probe_columns, start = {}, 0
        for effect in kept:
            probe_columns[effect] = start
            start += len(EFFECTS.get(effect).parameters)
        frozen = tuple(probe_columns[e] + k for e, k in named)
        return self.score_model(kept, point, frozen)

    def prune(self, scored: Scored, *, newest: set[str]) -> Scored:
        """Return the model without effects that the newest have made superfluous."""
        for name in [effect for effect in scored.effects if effect not in newest]:
            less = self.without(scored, name)
            if self.judge(name, less, scored).objections:
                scored = less
        return scored

    def weigh_rivals(self, name: str, final: Scored, untestable: dict[str, str]) -> tuple[Trial, ...]:
        """Return every other effect in the place of an accepted one, best first."""
        less = self.without(final, name)
        trials = []
        for other in self.candidates:
            if other in final.effects or other in untestable:
                continue
            trial = self.try_effect(other, less)
            if trial.scored is not None:
                gain = self.gain(final.left_out, trial.scored.left_out)
                back = self.gain(trial.scored.left_out, final.left_out)
                trials.append(replace(trial, gain=replace(gain, chance=back.chance)))
        return tuple(sorted(trials, key=lambda trial: -trial.score))
