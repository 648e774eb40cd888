"""Ablation: the errors of the test flights without each accepted effect, and the gain of each rival in its place.

All other effects are fitted again, so an effect gets no credit for errors that the others can remove as well.
Letters: C channels, W windows, O octaves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, set_label
from aerial_gym.sim2real.identify.least_squares.moments import flight_of_rows, time_block_of_rows
from aerial_gym.sim2real.identify.selection.select import Rival, SelectionResult
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation, rollout_rises
from aerial_gym.sim2real.judge.whiteness import EDGES, periodogram_of_flights, power_by_octave
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.redeclare import deviation_of_vehicle
from aerial_gym.sim2real.predict.rollout import RolloutErrors, rollout_errors_of_models
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

MOST_WEIGHED = 8  # Largest number of rivals that an ablation lists, the most probable first
JUDGED_S = (0.5, 1.0)  # Rollout horizons [s] at which an effect can be material


@dataclass(frozen=True)
class RivalGain:
    """Another effect in the place of an accepted one."""

    label: str  # Name of the rival, with its rotor if it acts on one

    name: str
    channel: str  # Channel whose mean square the accepted effect lowers by the largest share
    explains: float  # Share of that channel's mean square on the training flights that the rival removes
    instead_of: float  # Share that the accepted effect removes

    log_odds: float
    """Log odds of the best set with the rival and without the named effect, relative to the most probable set."""

    because: Finding  # Reason why the rival is not named

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return select_fields(self, "name", "channel", "explains", "instead_of", "log_odds", "because")


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """Relative rise of the errors of the test flights when one accepted effect is removed."""

    residual: dict[str, Rise]
    """Rise of the residual (rms) of each channel, without offsets of flights or with deviations where that shows it better."""

    rollout: dict[float, dict[str, Rise]]
    """Rise of the free rollout's errors, by horizon [s] and quantity; empty without velocity in the logs."""

    least: float  # Smallest relative rise that is material
    rivals: tuple[RivalGain, ...]  # The most probable first

    octaves: tuple[float, ...] = ()
    """Share of the residual's power that the effect removes in each octave, (O,), in the channel that rises most."""

    solid_below_hz: float | None = None
    """Frequency [Hz] up to which it removes a material share in every octave; None if not even in the lowest."""

    @property
    def material(self) -> bool | None:
        """Return True if an error rises by a material share for certain, False if none can; None if not shown."""
        rollouts = [rise for quantities in self.rollout.values() for rise in quantities.values()]
        rises = [*self.residual.values(), *rollouts]
        if any(rise.reaches(self.least, least=self.least) for rise in rises):
            return True
        return None if any(rise.high >= self.least for rise in rises) else False

    @property
    def largest_rise(self) -> tuple[str, Rise]:
        """Return the channel whose residual rises most."""
        return max(self.residual.items(), key=lambda item: item[1].value)

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        channel, rise = self.largest_rise
        return {
            "residual": {"channel": channel, **rise.as_mapping()},
            "rollout": {f"{horizon:g}": plain(rises) for horizon, rises in self.rollout.items()},
            **select_fields(self, "octaves", "solid_below_hz"),
        }


def ablations_of_effects(
    robot: RobotCfg,
    test: Sequence[Flight],
    predictors: tuple[Predictor, Predictor],
    points: tuple[ModelParams, ModelParams],
    evaluations: tuple[ModelEvaluation, ModelEvaluation],
    selection: SelectionResult,
    left: Sequence[Array],
) -> dict[str, Ablation]:
    """Return the ablation of each accepted effect; ``points`` are the declared and the final model.

    A residual rises as the models alone show it, about the offset of each flight, or with the deviations that fit the
    training flights best, whichever shows it better: a wrong mass hides a battery. ``left``: residuals of the final model
    with these deviations, (T, C) of each test flight.
    """
    train, tested = predictors
    _, final = points
    less = {name: selection.without[name] for name in selection.effect_names}
    without = {name: one.params for name, one in less.items()}
    if final.deviation is not None:
        off = {name: deviation_of_vehicle(one.deviation, robot) for name, one in less.items()}
        without = {name: replace(params, deviation=off[name]) for name, params in without.items()}
    flown: list[RolloutErrors] = []
    if "free" in evaluations[0].rollouts:
        if len(without) > 1 or final.deviation is not None:
            models, links = list(without.values()), [tested.load_links(one) for one in without.values()]
            options = {"links": links, "tolerances": tested.tolerances}
            flown = [one["free"] for one in rollout_errors_of_models(robot, test, models, {"free": False}, **options)]
        else:  # the only effect removed leaves the declared model
            flown = [evaluations[0].rollouts["free"]]
    residuals, group, flight = tested.residuals(final), time_block_of_rows(tested.times), flight_of_rows(tested.times)
    own = selection.flight_offsets.size > 0.0
    by_horizon, least = {}, selection.criteria.material

    def about_offsets(parts: Sequence[Array]) -> list[Array]:
        """Return residuals (T, C) about the mean of each flight in channels where each flight has its own offset."""
        return [part - own * part.mean(axis=0) for part in parts]

    def clearness(rise: Rise) -> tuple[bool, float]:
        return rise.reaches(least, least=least), rise.low

    for place, (name, params) in enumerate(without.items()):
        alone, within = tested.residuals(params), tested.residuals(less[name].model_with_deviations)
        pairs = ((alone, residuals), (about_offsets(alone), about_offsets(residuals)), (within, left))
        ways = [rise_with_interval(np.concatenate(a), np.concatenate(b), group, flight) for a, b in pairs]
        best = [max(zip(way, pairs, strict=True), key=lambda one: clearness(one[0])) for way in zip(*ways, strict=True)]
        rises = [rise for rise, _ in best]
        largest_rise = int(np.argmax([rise.value for rise in rises]))
        octaves = share_removed_by_octave(tested, *best[largest_rise][1], largest_rise)
        rollout = rollout_rises_by_horizon(flown[place], evaluations[1].rollouts["free"]) if flown else {}
        by_horizon[name] = Ablation(
            residual={channel.name: rise for channel, rise in zip(tested.channels, rises, strict=True)},
            rollout=rollout,
            least=least,
            rivals=gains_of_rivals(name, selection, train),
            octaves=octaves,
            solid_below_hz=highest_reliable_frequency(octaves, tested.bandwidth, least),
        )
    return by_horizon


def share_removed_by_octave(
    predictor: Predictor, without: Sequence[Array], residuals: Sequence[Array], place: int
) -> tuple[float, ...]:
    """Return the share of a channel's residual power that an effect removes in each octave, (O,)."""
    powers = []
    for values in (without, residuals):
        own = [rows[:, place : place + 1] for rows in values]
        frequency, power = periodogram_of_flights(predictor.times, own, predictor.bandwidth, tapered=True)
        powers.append(power_by_octave(frequency, power, predictor.bandwidth)[:, 0])
    return tuple((1.0 - powers[1] / np.maximum(powers[0], 1e-300)).tolist())


def highest_reliable_frequency(octaves: Sequence[float], bandwidth: float, least: float) -> float | None:
    """Return the frequency [Hz] up to which an effect lowers the rms of every octave by at least ``least``."""
    edge = None
    for taken, upper in zip(octaves, EDGES[1:], strict=True):
        if taken < 1.0 - (1.0 - least) ** 2:
            break
        edge = upper * bandwidth
    return edge


def rollout_rises_by_horizon(without: RolloutErrors, errors: RolloutErrors) -> dict[float, dict[str, Rise]]:
    """Return the relative rise of each rollout error in the same windows, by horizon ``JUDGED_S`` and quantity."""
    by_horizon: dict[float, dict[str, Rise]] = {horizon: {} for horizon in JUDGED_S if horizon in errors.horizons}
    for quantity, horizon, rise in rollout_rises(without, errors):
        if horizon in by_horizon:
            by_horizon[horizon][quantity] = rise
    return by_horizon


def gains_of_rivals(name: str, selection: SelectionResult, train: Predictor) -> tuple[RivalGain, ...]:
    """Return the rivals of a named effect with the share of the training error that each removes, best first.

    Each model also has the deviations within the tolerances that fit best beside its effects.
    """

    def squares(fitted: EffectSetFit) -> Array:
        return np.mean(np.square(np.concatenate(train.residuals(fitted.model_with_deviations))), axis=0)

    left, own = squares(selection.without[name]), squares(selection.named)
    place, results = int(np.argmin(own / left)), []
    instead_of, channel = float(max(0.0, 1.0 - own[place] / left[place])), train.channels[place].name
    for rival in selection.effect_rivals(name)[:MOST_WEIGHED]:
        (label,) = set_label([(rival.effect, rival.fitted.params.effects[rival.effect])], ())
        explains = float(max(0.0, 1.0 - squares(rival.fitted)[place] / left[place]))
        reason = reason_against_rival(name, rival)
        results.append(RivalGain(label, rival.effect, channel, explains, instead_of, rival.log_odds, reason))
    return tuple(results)


def reason_against_rival(name: str, rival: Rival) -> Finding:
    """Return the reason why a rival is not named in place of the accepted effect."""
    if rival.is_clearly_less_probable:
        return Finding("rival_less_probable", rival.effect, {"log_odds": rival.log_odds})
    return Finding("rival_wider" if rival.wider else "rival_not_rejected", rival.effect, {"effect": name})
