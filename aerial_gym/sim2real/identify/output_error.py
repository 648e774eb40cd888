"""The accepted effects fitted again by output error: whole open-loop rollouts against the flights, in place of one step each.

A centre of mass that is off by a fraction of a millimetre, within the tolerance, turns a vehicle over in seconds: rollouts are
flown with the deviations that single steps ask for, and these are fitted further.
Rollouts feel what lasts, single steps what comes at once; noise of the inputs turns a rollout, so that its parameters may be
off where logs are noisy. Rollouts decide only if they predict flights left out better, make no single step worse, and put no
parameter where single steps rule it out; else the first fit stands. Where they would but for the latter two, both contradict
each other, and the report says so: commands whose times are not exact, for one, turn rollouts and hardly single steps.
Letters: W windows, K parameters, B blocks of time, C channels.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import ImuEffect, LoadEffect
from aerial_gym.sim2real.identify.candidates.library import neutral_of
from aerial_gym.sim2real.identify.candidates.testable import at_bounds
from aerial_gym.sim2real.identify.least_squares.covariance import Uncertainty, uncertainty
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit, best_step, linearise
from aerial_gym.sim2real.identify.least_squares.parameters import params_of, scales, with_params
from aerial_gym.sim2real.identify.selection.scoring import Criteria, Scored
from aerial_gym.sim2real.identify.selection.select import Selection
from aerial_gym.sim2real.identify.window_rollouts import WINDOW_S, Linear, Rollouts
from aerial_gym.sim2real.predict.model_params import ModelParams, declared_params
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.windows import Windows, find_windows

Array = NDArray[np.float64]

WINDOW_EVERY_S = 1.0
MOST_WINDOWS = 120
"""One after the other, spread over all flights if there were more."""

FAR = 5.0
"""Single steps and rollouts contradict each other beyond so many standard deviations."""

MOST_ITERATIONS = 3
SMALL = 0.05
"""The last step is shorter than this share of each standard deviation."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """One parameter, fitted on single steps and on rollouts."""

    effect: str
    parameter: str
    step: float
    rollout: float
    std: float
    """Of the second."""

    distance: float
    """Between both, in standard deviations."""

    @property
    def far(self) -> bool:
        """Whether both cannot be right."""
        return abs(self.distance) > FAR


@dataclass(frozen=True, kw_only=True)
class Refit:
    """What output error says about the accepted effects."""

    windows: int
    """W; 0 if there was nothing to fit."""

    changes: tuple[Change, ...]

    velocity: float
    """Relative fall of the velocity error (rms along the windows) of flights left out."""

    attitude: float
    """The same of the attitude error."""

    gains: bool
    """Whether that is certain and material."""

    objections: tuple[str, ...]
    """Why the first fit stands; empty if rollouts decide."""

    scored: Scored | None
    """The model that rollouts ask for, if there was something to fit."""

    @property
    def adopted(self) -> bool:
        """Return whether rollouts decide."""
        return not self.objections

    @property
    def contradictions(self) -> list[str]:
        """Return the parameters on which single steps and rollouts cannot both be right."""
        return [
            f"single steps and rollouts contradict each other: {change.effect} {change.parameter} is {change.step:.4g} by the "
            f"first, {change.rollout:.4g} ± {1.96 * change.std:.2g} by the second; look for a scale or delay of a sensor, "
            "or an effect that no name has"
            for change in self.changes
            if change.far and self.gains
        ]

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {
            "adopted": self.adopted,
            "because": list(self.objections),
            "windows": self.windows,
            "left_out": {"velocity_falls": self.velocity, "attitude_falls": self.attitude},
            "params": [vars(change) for change in self.changes],
        }


def refit_on_rollouts(predictor: Predictor, selection: Selection) -> Refit:
    """Return the accepted effects fitted by output error on the training flights.

    Source:
        Klein, Morelli (2006), Aircraft System Identification, chapter 6 (output error); Pauli, Racugno, Ventura (2011),
        Bayesian composite marginal likelihoods, section 3 (what correlated samples count).
    """
    if reason := impossible(predictor, selection):
        return _not_done(reason, 0)
    fit = selection.final.fit
    windows = find_windows(predictor.flights, WINDOW_S, every=WINDOW_EVERY_S, most=MOST_WINDOWS)
    runs = Rollouts(predictor, windows)
    deviation = best_within_tolerances(predictor.robot, fit, selection.left_out.weights.weight).deviation
    frozen, params = fit.frozen, replace(fit.params, deviation=deviation)
    found = runs.linearise(fit.effects, params, frozen)
    if windows.row.size < 2 * _moving(found.fit):
        reason = f"the training flights hold only {windows.row.size} windows of {WINDOW_S:g} s"
        return _not_done(reason, windows.row.size)
    unseen = np.diag(uncertainty(found.fit, found.weight).plain) > 1.0
    frozen |= {fit.owners[k] for k in found.fit.free_effects[unseen]}
    for _ in range(MOST_ITERATIONS):
        found = replace(found, fit=replace(found.fit, frozen=frozen))
        step = best_step(found.fit, found.weight, found.fit.free_all)[: fit.num_effect_params]
        std = dict(zip(found.fit.free_effects.tolist(), uncertainty(found.fit, found.weight).std, strict=True))
        if all(abs(step[k]) < SMALL * std[k] for k in std):
            break
        values = params_of(params, fit.effects) + scales(fit.effects) * step
        params = with_params(predictor.robot, params, fit.effects, values)
        found = runs.linearise(fit.effects, params, frozen)
    return judge(predictor, selection, found, windows)


def _not_done(reason: str, windows: int) -> Refit:
    return Refit(
        windows=windows, changes=(), velocity=0.0, attitude=0.0, gains=False, objections=(reason,), scored=None
    )


def _moving(fit: Fit) -> int:
    """Return how many numbers, of effects and tolerances, the rollouts depend on."""
    return np.count_nonzero(np.einsum("bckk->k", fit.moments.product))


def best_within_tolerances(robot: RobotCfg, fit: Fit, weight: Array) -> ModelParams:
    """Return a fitted model with the deviations within the tolerances that fit its flights best."""
    step = best_step(fit, weight, fit.free_all)
    values = params_of(fit.params, fit.effects) + scales(fit.effects) * step[: fit.num_effect_params]
    return replace(with_params(robot, fit.params, fit.effects, values), deviation=step[fit.num_effect_params :])


def impossible(predictor: Predictor, selection: Selection) -> str:
    """Return why there is nothing to fit on rollouts; empty if there is."""
    flights, names = predictor.flights, selection.accepted
    if not names:
        return "no effect is accepted"
    if any(flight.lin_vel is None or flight.attitude_integrated for flight in flights):
        return "the logs have no velocity and attitude to compare rollouts with"
    if any(EFFECTS.get(name).kind is LoadEffect for name in selection.final.fit.params.effects):
        return "where a slung load hangs at the start of a window is not logged"
    if all(EFFECTS.get(name).kind is ImuEffect for name in names):
        return "errors of the inertial sensors change no rollout"
    return ""


def judge(predictor: Predictor, selection: Selection, found: Linear, windows: Windows) -> Refit:
    """Return the refit with every objection to it: judged on flights left out, each time without it in both fits."""
    one, left_out, effects = selection.final, selection.left_out, found.fit.effects
    params, own = replace(found.fit.params, deviation=None), found.fit.num_effect_params
    predicted = predictor.predict(params)
    tolerance, offsets = tolerance_jacobian(predictor, found.fit.params), selection.own_offsets
    fit = replace(
        linearise(predictor, effects, params, tolerance, base=predicted, offsets=offsets)[0], frozen=one.fit.frozen
    )
    deviation = found.fit.params.deviation
    assert deviation is not None
    ahead = (params_of(one.fit.params, effects) - params_of(params, effects)) / scales(effects)
    ahead = np.concatenate((ahead, -deviation))  # from where rollouts are linearised to where single steps are
    shown = np.isin(np.arange(own), found.fit.free_effects)
    fold = left_out.fold
    part = (
        windows.flight
        if len(predictor.flights) > 1
        else np.arange(windows.row.size) * (fold.max() + 1) // windows.row.size
    )
    by_step, by_rollout = (np.zeros((windows.row.size, fit.low.size)) for _ in range(2))
    squares = np.zeros_like(one.left_out)
    for left in np.unique(fold):
        single = best_step(one.fit, left_out.weights.weight, one.fit.free_all, np.flatnonzero(fold != left)) + ahead
        step = best_step(found.fit, found.weight, found.fit.free_all, np.flatnonzero(part != left))
        step[:own] = np.where(shown, step[:own], single[:own])
        by_step[part == left], by_rollout[part == left] = single, step
        squares[fold == left] = _squares(fit, step[:own], left_out.weights.weight, fold != left)[fold == left]
    before, after = found.raw.squares_after(by_step), found.raw.squares_after(by_rollout)
    falls = 1.0 - np.sqrt(after.sum(axis=0) / before.sum(axis=0))
    scored = Scored(fit=fit, spread=_joined(one.spread, uncertainty(found.fit, found.weight)), left_out=squares)
    doubts = _doubts(before, after, falls, windows, selection.criteria)
    changes = _changes(one, found)
    objections = [
        *doubts,
        *left_out.harms(left_out.gain(one.left_out, squares)),
        *(
            f"single steps rule out its {c.effect} {c.parameter} by {abs(c.distance):.1f} deviations"
            for c in changes
            if c.far
        ),
        *_at_bounds(predictor, fit),
    ]
    return Refit(
        windows=windows.row.size,
        changes=changes,
        velocity=float(falls[0]),
        attitude=float(falls[1]),
        gains=not doubts,
        objections=tuple(objections),
        scored=scored,
    )


def _at_bounds(predictor: Predictor, fit: Fit) -> list[str]:
    declared, robot = declared_params(predictor.robot), predictor.robot
    return [
        f"{name} {parameter} runs into its physical bound"
        for name in fit.effects
        for parameter in at_bounds(name, fit.params, neutral_of(name, declared, robot), robot)
    ]


def _squares(fit: Fit, step: Array, weight: Array, blocks: NDArray[np.bool_]) -> Array:
    """Return the squares (B, C) of single steps under a step of the effects, and the deviations that fit some blocks best."""
    whole = np.concatenate((step, np.zeros(fit.low.size - step.size)))
    moments = fit.moments
    change = np.einsum("bckl,l->bck", moments.product, whole)
    there = replace(
        moments, square=moments.squares_after(np.tile(whole, (blocks.size, 1))), gradient=moments.gradient - change
    )
    deviation = best_step(replace(fit, moments=there), weight, np.arange(step.size, whole.size), np.flatnonzero(blocks))
    return there.squares_after(np.tile(deviation, (blocks.size, 1)))


def _doubts(before: Array, after: Array, falls: Array, windows: Windows, rules: Criteria) -> list[str]:
    """Return why rollouts of flights left out (squares (W, 2)) do not speak for the refit."""
    shares = (before - after) / before.sum(axis=0)
    both = shares.sum(axis=1)
    p_value = p_value_of_gain(both, windows)
    better = np.mean([both[windows.flight == f].sum() > 0.0 for f in np.unique(windows.flight)])
    found = []
    if p_value > rules.left_out_significance:
        found.append(f"the gain on flights left out may be chance (p = {p_value:.2g})")
    if better < rules.flights_better:
        found.append(f"only {better:.0%} of the flights left out are predicted better")
    if max(falls) < rules.material:
        found.append(f"it takes at most {max(*falls, 0.0):.1%} off the rollout errors of flights left out")
    for name, fall, share in zip(("velocity", "attitude"), falls, shares.T, strict=True):
        if fall < -rules.harmless and p_value_of_gain(-share, windows) < rules.left_out_significance:
            found.append(f"it makes the {name} of rollouts worse by {-fall:.1%}")
    return found


def p_value_of_gain(gain: Array, windows: Windows) -> float:
    """Return the probability that a mean gain of windows, (W,), is chance; windows of a cluster count as one."""
    clusters = np.array([gain[windows.cluster == c].sum() for c in np.unique(windows.cluster)])
    spread = clusters.std(ddof=1) / np.sqrt(clusters.size) if clusters.size > 1 else np.inf
    return float(stats.t.sf(clusters.mean() / max(spread, 1e-300), max(clusters.size - 1, 1)))


def _joined(steps: Uncertainty, rollouts: Uncertainty) -> Uncertainty:
    """Return the spread of single steps with that of rollouts for the parameters that these show."""
    places = np.array([int(np.flatnonzero(steps.columns == k)[0]) for k in rollouts.columns], dtype=int)

    def joined(one: Array | None, other: Array | None) -> Array | None:
        if one is None or other is None:
            return None
        result = one.copy()
        result[places], result[:, places] = 0.0, 0.0
        result[np.ix_(places, places)] = other
        return result

    names = ("plain", "blocks", "flights", "tolerance")
    matrices = {name: joined(getattr(steps, name), getattr(rollouts, name)) for name in names}
    return replace(steps, step=np.zeros_like(steps.step), num_blocks=rollouts.num_blocks, **matrices)


def _changes(one: Scored, found: Linear) -> tuple[Change, ...]:
    """Return what rollouts say of each parameter that they show."""
    known, scale = dict(zip(one.spread.columns.tolist(), one.spread.std, strict=True)), scales(one.effects)
    spread, changes = uncertainty(found.fit, found.weight), []
    first, second = params_of(one.fit.params, one.effects), params_of(found.fit.params, one.effects)
    for k, std in zip(spread.columns.tolist(), spread.std, strict=True):
        effect, place = one.fit.owners[k]
        changes.append(
            Change(
                effect=effect,
                parameter=EFFECTS.get(effect).parameters[place].name,
                step=float(first[k]),
                rollout=float(second[k]),
                std=float(std * scale[k]),
                distance=float((second[k] - first[k]) / scale[k] / np.hypot(std, known[k])),
            )
        )
    return tuple(changes)
