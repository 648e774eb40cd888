"""Ablation: what each accepted effect is worth, by the model without it, and by others in its place.

The model without an effect has the others fitted again, so that what they can take over is not counted for it.
Letters: C channels, W windows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit, fit_effects
from aerial_gym.sim2real.identify.least_squares.moments import flight_of_rows, time_groups
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.select import Selection, Trial
from aerial_gym.sim2real.judge.evaluation import Evaluation
from aerial_gym.sim2real.judge.whiteness import EDGES, in_octaves, lines
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES, RolloutErrors, roll_out
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

Array = NDArray[np.float64]

JUDGED_S = (0.5, 1.0)
"""Horizons at which a rollout decides on what is material [s]."""


@dataclass(frozen=True, kw_only=True)
class Rival:
    """Another effect in the place of an accepted one."""

    label: str
    """Its name, with its rotor if it has one."""

    name: str
    channel: str
    """Where the accepted effect explains most."""

    explains: float
    """Share of the mean square there, on flights left out, that the rival takes away in its place."""

    instead_of: float
    """Share that the accepted effect takes away."""

    score: float
    """Gain in log likelihood over the accepted effect, on flights left out; positive: better."""

    because: str
    """Why it is not the one."""

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {
            "name": self.name,
            "channel": self.channel,
            "explains": self.explains,
            "instead_of": self.instead_of,
            "score": self.score,
            "because": self.because,
        }


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """What becomes worse without an accepted effect, on the test flights."""

    residual: dict[str, Rise]
    """Of the residual of each channel."""

    rollout: dict[float, dict[str, Rise]]
    """Of the free rollout, by horizon [s] and quantity; empty without velocity in the logs."""

    least: float
    """Share from which on a rise is material."""

    rivals: tuple[Rival, ...]
    """Best first."""

    octaves: tuple[float, ...] = ()
    """Share of the power without it that it takes away from that residual in each octave below the band, (O,)."""

    solid_below_hz: float | None = None
    """It takes that share away up to this frequency [Hz], and less above; None where it takes it nowhere."""

    @property
    def material(self) -> bool | None:
        """Return whether the interval of a rise, of residual or rollout error, shows that it is material; None: not shown."""
        rollouts = [rise for quantities in self.rollout.values() for rise in quantities.values()]
        rises = [*self.residual.values(), *rollouts]
        if any(rise.low >= self.least for rise in rises):
            return True
        return None if any(rise.high >= self.least for rise in rises) else False

    @property
    def most(self) -> tuple[str, Rise]:
        """Return the channel whose residual rises most."""
        return max(self.residual.items(), key=lambda item: item[1].value)

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        channel, rise = self.most
        horizons = {
            f"{h:g}": {q: r.as_mapping() for q, r in quantities.items()} for h, quantities in self.rollout.items()
        }
        return {
            "residual": {"channel": channel, **rise.as_mapping()},
            "rollout": horizons,
            "octaves": list(self.octaves),
            "solid_below_hz": self.solid_below_hz,
        }


def ablations(
    robot: RobotCfg,
    test: Sequence[Flight],
    predictors: tuple[Predictor, Predictor],
    points: tuple[ModelParams, ModelParams],
    evaluations: tuple[Evaluation, Evaluation],
    selection: Selection,
) -> dict[str, Ablation]:
    """Return what each accepted effect is worth.

    Args:
        robot: Declared robot.
        test: Test flights.
        predictors: Of training and test flights.
        points: The declared and the final model.
        evaluations: Of both.
        selection: The selection.
    """
    train, tested = predictors
    declared, final = points
    residuals, group, flight = tested.residuals(final), time_groups(tested.times), flight_of_rows(tested.times)
    residual = np.concatenate(residuals)
    found = {}
    for name in selection.accepted:
        less = without_effect(train, declared, selection, name)
        left = tested.residuals(less.point)
        rises = rise_with_interval(np.concatenate(left), residual, group, flight)
        most = int(np.argmax([rise.value for rise in rises]))
        octaves = taken_from_octaves(tested, left, residuals, most)
        rollout: dict[float, dict[str, Rise]] = {}
        if "free" in evaluations[1].rollouts:
            alone = len(selection.accepted) == 1
            links = None if alone else tested.links(less.point)
            errors = evaluations[0].rollouts["free"] if alone else roll_out(robot, test, less.point, links=links)
            rollout = rollout_rises(errors, evaluations[1].rollouts["free"])
        found[name] = Ablation(
            residual={channel.name: rise for channel, rise in zip(tested.channels, rises, strict=True)},
            rollout=rollout,
            least=selection.criteria.material,
            rivals=rivals_of(name, selection, less, tested.channels),
            octaves=octaves,
            solid_below_hz=solid_below(octaves, tested.bandwidth, selection.criteria.material),
        )
    return found


def taken_from_octaves(
    predictor: Predictor, without: Sequence[Array], residuals: Sequence[Array], place: int
) -> tuple[float, ...]:
    """Return the share of the power in each octave of a channel that an effect takes away, (O,)."""
    powers = []
    for values in (without, residuals):
        own = [rows[:, place : place + 1] for rows in values]
        frequency, power = lines(predictor.times, own, predictor.bandwidth, tapered=True)
        powers.append(in_octaves(frequency, power, predictor.bandwidth)[:, 0])
    return tuple((1.0 - powers[1] / np.maximum(powers[0], 1e-300)).tolist())


def solid_below(octaves: Sequence[float], bandwidth: float, least: float) -> float | None:
    """Return the frequency [Hz] up to which an effect takes ``least`` off the rms of every octave, from the lowest on."""
    edge = None
    for taken, upper in zip(octaves, EDGES[1:], strict=True):
        if taken < 1.0 - (1.0 - least) ** 2:
            break
        edge = upper * bandwidth
    return edge


def without_effect(train: Predictor, declared: ModelParams, selection: Selection, name: str) -> Fit:
    """Return the final model with one effect taken back to what is declared, and the others fitted again."""
    fit = selection.final.fit
    kept = tuple(effect for effect in fit.effects if effect != name)
    if not kept:
        return selection.declared.fit
    effects = {other: params for other, params in fit.point.effects.items() if other != name}
    if name in declared.effects:
        effects[name] = declared.effects[name]
    nothing = [np.zeros((*measured.shape, 0)) for measured in train.measured]
    frozen = frozenset(owner for owner in fit.frozen if owner[0] != name)
    return fit_effects(train, kept, ModelParams(effects=effects), nothing, selection.weights.weight, frozen=frozen)


def rollout_rises(without: RolloutErrors, errors: RolloutErrors) -> dict[float, dict[str, Rise]]:
    """Return by which share the errors of the same windows rise at the judged horizons."""
    found: dict[float, dict[str, Rise]] = {horizon: {} for horizon in JUDGED_S if horizon in errors.horizons}
    for quantity in QUANTITIES:
        more, less = getattr(without, quantity), getattr(errors, quantity)
        if less is not None:
            found_rises = rise_with_interval(more, less, errors.windows.cluster, errors.windows.flight)
            rises = dict(zip(errors.horizons, found_rises, strict=True))
            for horizon, quantities in found.items():
                quantities[quantity] = rises[horizon]
    return found


def rivals_of(name: str, selection: Selection, less: Fit, channels: Sequence[Channel]) -> tuple[Rival, ...]:
    """Return the others in the place of an accepted effect, best first; ``less`` is the model without it."""
    left = selection.left_out.squares(less)
    own = selection.left_out.gain(left, selection.final.left_out)
    place = int(np.argmax(own.falls))
    found = []
    for trial in selection.rivals[name]:
        if trial.scored is None or trial.gain is None:
            continue
        gain = selection.left_out.gain(left, trial.scored.left_out)
        found.append(
            Rival(
                label=trial.label,
                name=trial.effect,
                channel=channels[place].name,
                explains=explained(gain.falls[place]),
                instead_of=explained(own.falls[place]),
                score=trial.gain.score,
                because=rejection(trial, selection, selection.acceptance[name]),
            )
        )
    return tuple(sorted(found, key=lambda rival: -rival.score))


def explained(fall: float) -> float:
    """Return the share of a mean square that a relative fall of the rms takes away."""
    return max(0.0, 1.0 - (1.0 - fall) ** 2)


def rejection(trial: Trial, selection: Selection, accepted: Trial) -> str:
    """Return why a rival is not the one in the place of an accepted effect."""
    if trial.objections:
        return "; ".join(trial.objections)
    assert trial.gain is not None
    if trial.effect in selection.surrogates:
        return f"only stands in for what remains and follows {selection.surrogates[trial.effect]}"
    if told_apart(trial, selection):
        return f"predicts flights left out worse (p = {trial.gain.p_value:.1g})"
    if trial.num_free > accepted.num_free:
        return f"as good with {trial.num_free} parameters in place of {accepted.num_free}"
    if trial.complexity > accepted.complexity:
        return f"as good, but it is a wider case of {' or '.join(EFFECTS.get(trial.effect).contains)}"
    return "not rejected: these flights cannot tell them apart"


def told_apart(trial: Trial, selection: Selection) -> bool:
    """Return whether an accepted effect is clearly better than a rival: certainly, and by more than a trifle."""
    assert trial.gain is not None
    return trial.gain.p_value <= selection.criteria.rival_significance and trial.gain.score < -LEAST_SCORE
