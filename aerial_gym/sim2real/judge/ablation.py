"""Ablation: what each accepted effect is worth, by the model without it, and by others in its place.

The model without an effect has the others fitted again, so that what they can take over is not counted for it.
Letters: C channels, W windows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.evidence.fitting import Fitted, label_of
from aerial_gym.sim2real.identify.least_squares.moments import flight_of_rows, time_groups
from aerial_gym.sim2real.identify.selection.select import Rival, SelectionResult
from aerial_gym.sim2real.judge.evaluation import Evaluation, rollout_rises
from aerial_gym.sim2real.judge.whiteness import EDGES, in_octaves, lines
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.plain import fields_of, plain
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import RolloutErrors, roll_out_models
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

MOST_WEIGHED = 8
"""Rivals of an effect that are told, the most probable."""

JUDGED_S = (0.5, 1.0)
"""Horizons at which a rollout decides on what is material [s]."""


@dataclass(frozen=True, kw_only=True)
class WeighedRival:
    """Another effect in the place of an accepted one."""

    label: str
    """Its name, with its rotor if it has one."""

    name: str
    channel: str
    """Where the accepted effect explains most."""

    explains: float
    """Share of the mean square there, on the training flights, that the rival takes away in its place."""

    instead_of: float
    """Share that the accepted effect takes away."""

    log_odds: float
    """Of the best set with it and without the named effect, over the most probable one."""

    because: Finding
    """Reason why it is not the one."""

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return fields_of(self, "name", "channel", "explains", "instead_of", "log_odds", "because")


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """What becomes worse without an accepted effect, on the test flights."""

    residual: dict[str, Rise]
    """Of the residual of each channel."""

    rollout: dict[float, dict[str, Rise]]
    """Of the free rollout, by horizon [s] and quantity; empty without velocity in the logs."""

    least: float
    """Share from which on a rise is material."""

    rivals: tuple[WeighedRival, ...]
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
        return {
            "residual": {"channel": channel, **rise.as_mapping()},
            "rollout": {f"{horizon:g}": plain(rises) for horizon, rises in self.rollout.items()},
            **fields_of(self, "octaves", "solid_below_hz"),
        }


def ablations(
    robot: RobotCfg,
    test: Sequence[Flight],
    predictors: tuple[Predictor, Predictor],
    points: tuple[ModelParams, ModelParams],
    evaluations: tuple[Evaluation, Evaluation],
    selection: SelectionResult,
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
    _, final = points
    without = {name: selection.chosen.without[name].params for name in selection.accepted}
    flown: list[RolloutErrors] = []
    if "free" in evaluations[0].rollouts:
        if len(without) > 1:
            models, links = list(without.values()), [tested.links(less) for less in without.values()]
            flown = [one["free"] for one in roll_out_models(robot, test, models, {"free": False}, links=links)]
        else:  # it is the declared model
            flown = [evaluations[0].rollouts["free"]]
    residuals, group, flight = tested.residuals(final), time_groups(tested.times), flight_of_rows(tested.times)
    residual = np.concatenate(residuals)
    found = {}
    for place, (name, less) in enumerate(without.items()):
        left = tested.residuals(less)
        rises = rise_with_interval(np.concatenate(left), residual, group, flight)
        most = int(np.argmax([rise.value for rise in rises]))
        octaves = taken_from_octaves(tested, left, residuals, most)
        rollout = judged_rises(flown[place], evaluations[1].rollouts["free"]) if flown else {}
        found[name] = Ablation(
            residual={channel.name: rise for channel, rise in zip(tested.channels, rises, strict=True)},
            rollout=rollout,
            least=selection.criteria.material,
            rivals=weighed_rivals(name, selection, train),
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


def judged_rises(without: RolloutErrors, errors: RolloutErrors) -> dict[float, dict[str, Rise]]:
    """Return by which share the errors of the same windows rise at the judged horizons."""
    found: dict[float, dict[str, Rise]] = {horizon: {} for horizon in JUDGED_S if horizon in errors.horizons}
    for quantity, horizon, rise in rollout_rises(without, errors):
        if horizon in found:
            found[horizon][quantity] = rise
    return found


def weighed_rivals(name: str, selection: SelectionResult, train: Predictor) -> tuple[WeighedRival, ...]:
    """Return the others in the place of a named effect with what they explain of the training flights, best first.

    Each model with the deviations within the tolerances that fit best beside its effects.
    """

    def squares(fitted: Fitted) -> Array:
        return np.mean(np.square(np.concatenate(train.residuals(fitted.within))), axis=0)

    left, own = squares(selection.chosen.without[name]), squares(selection.chosen.named)
    place = int(np.argmin(own / left))
    return tuple(
        WeighedRival(
            label=label_of([(rival.effect, rival.fitted.params.effects[rival.effect])], ())[0],
            name=rival.effect,
            channel=train.channels[place].name,
            explains=float(max(0.0, 1.0 - squares(rival.fitted)[place] / left[place])),
            instead_of=float(max(0.0, 1.0 - own[place] / left[place])),
            log_odds=rival.log_odds,
            because=rejection(name, rival),
        )
        for rival in selection.rivals_of(name)[:MOST_WEIGHED]
    )


def rejection(name: str, rival: Rival) -> Finding:
    """Return the reason why a rival does not stand in the place of a named effect."""
    if rival.told_apart:
        return Finding("rival_less_probable", rival.effect, {"log_odds": rival.log_odds})
    return Finding("rival_wider" if rival.wider else "rival_not_rejected", rival.effect, {"effect": name})
