"""Before and after in parts: per flight, and in the regime in which an effect acts.

Letters: T rows, C channels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.identify.candidates.library import neutral_of
from aerial_gym.sim2real.identify.candidates.structure import rows_of
from aerial_gym.sim2real.identify.least_squares.moments import time_groups
from aerial_gym.sim2real.judge.evaluation import Evaluation, gap_closed
from aerial_gym.sim2real.judge.outcome import Outcome, channel_outcome, rollout_outcome
from aerial_gym.sim2real.logs.flights import Flight, had_by_all
from aerial_gym.sim2real.plain import fields_of
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES
from aerial_gym.sim2real.statistics import Rise, Rms, rise_with_interval, rms_with_interval

ACTS_FROM = 0.75
"""An effect acts in the rows in which its contribution is above this quantile."""

ROLLOUT_S = 1.0
"""Horizon that stands for rollouts in a table by flights [s]."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """One quantity of one flight, before and after."""

    unit: str
    before: Rms
    after: Rms
    floor: float | None
    """Noise floor (rms) of a channel on this flight; None where it is not known."""

    became: Outcome
    """What it is, and what became of it on this flight."""

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        found = {"before": self.before.value, "after": self.after.value, "noise_floor": self.floor}
        return {**found, **self.became.as_mapping()}


@dataclass(frozen=True, kw_only=True)
class Regime:
    """The rows of the test flights in which an effect acts most."""

    channel: str
    """Where its contribution stands out most."""

    unit: str
    before: Rms
    after: Rms
    gap_closed: float | None
    """Share of what lies above the noise floor there that the correction takes away."""

    looks: dict[str, tuple[float, float]]
    """Mean speed [m/s], height [m] and turn rate [rad/s] in these rows, and in the others."""

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return fields_of(self, "channel", "before", "after", "gap_closed")


def by_flight(
    predictor: Predictor,
    models: tuple[ModelParams, ModelParams],
    evaluations: tuple[Evaluation, Evaluation],
    floors: Sequence[Array | None],
    *,
    least: float,
    seed: int,
) -> dict[str, list[Part]]:
    """Return the residual of each channel and the free rollout at 1 s, flight by flight.

    Args:
        predictor: The flights.
        models: The declared and the corrected one.
        evaluations: Of both.
        floors: Noise floor of each flight, each (C,); None: not known.
        least: Share from which on a change is material.
        seed: Of the bootstrap.
    """
    before, after = (predictor.residuals(model) for model in models)
    found: dict[str, list[Part]] = {}
    for index, flight in enumerate(predictor.flights):
        floor = floors[index]
        level = [None] * len(predictor.channels) if floor is None else floor.tolist()
        changes = _changes(before[index], after[index], time_groups([predictor.times[index]]), seed)
        found[flight.name] = [
            Part(
                unit=channel.unit,
                before=rms[0],
                after=rms[1],
                floor=own,
                became=channel_outcome(channel, rise, least),
            )
            for channel, own, (rms, rise) in zip(predictor.channels, level, changes, strict=True)
        ] + _rollout_parts(index, evaluations, least, seed)
    return found


def _changes(before: Array, after: Array, group: Indices, seed: int) -> list[tuple[tuple[Rms, Rms], Rise]]:
    """Return the rms of both (S, C), and by how much it rises, of each column."""
    rms = zip(*(rms_with_interval(values, group, seed=seed) for values in (before, after)), strict=True)
    rises = rise_with_interval(after, before, group, np.zeros(len(before), dtype=np.int64))
    return list(zip(rms, rises, strict=True))


def _rollout_parts(index: int, evaluations: tuple[Evaluation, Evaluation], least: float, seed: int) -> list[Part]:
    if "free" not in evaluations[0].rollouts or ROLLOUT_S not in evaluations[0].rollouts["free"].horizons:
        return []
    before, after = (evaluation.rollouts["free"] for evaluation in evaluations)
    own, column, parts = before.windows.flight == index, before.horizons.index(ROLLOUT_S), []
    for quantity, unit in QUANTITIES.items():
        old, new = getattr(before, quantity), getattr(after, quantity)
        if old is None or not own.any():
            continue
        at = slice(column, column + 1)
        ((rms, rise),) = _changes(old[own, at], new[own, at], before.windows.cluster[own], seed)
        became = rollout_outcome("free", quantity, ROLLOUT_S, rise, least)
        parts.append(Part(unit=unit, before=rms[0], after=rms[1], floor=None, became=became))
    return parts


def where_it_acts(
    predictor: Predictor,
    declared: ModelParams,
    final: ModelParams,
    name: str,
    weight: Array,
    floor: Array | None,
    *,
    seed: int,
) -> Regime:
    """Return before and after in the rows in which an effect changes the prediction most.

    Its contribution is the final model minus the same one with the effect at neutral; rows are ranked by its size over all
    channels in units of ``weight``, (C,).
    """
    neutral = final.with_effect(name, neutral_of(name, declared, predictor.robot))
    change = np.concatenate([a - b for a, b in zip(predictor.predict(final), predictor.predict(neutral), strict=True)])
    size = np.sqrt((weight * change**2).sum(axis=1))
    acts = size >= np.quantile(size, ACTS_FROM)
    place = int(np.argmax(weight * (change[acts] ** 2).mean(axis=0)))
    group = time_groups(predictor.times)[acts]
    rms = [
        rms_with_interval(np.concatenate(predictor.residuals(params))[acts][:, place : place + 1], group, seed=seed)[0]
        for params in (declared, final)
    ]
    channel = predictor.channels[place]
    return Regime(
        channel=channel.name,
        unit=channel.unit,
        before=rms[0],
        after=rms[1],
        gap_closed=gap_closed(rms[0].value, rms[1].value, None if floor is None else float(floor[place])),
        looks=_looks(predictor.flights, predictor.times, acts),
    )


def _looks(flights: Sequence[Flight], times: Sequence[Array], acts: Flags) -> dict[str, tuple[float, float]]:
    """Return means over the rows in which an effect acts and over the others."""
    parts = []
    for flight, time in zip(flights, times, strict=True):
        rows, found = rows_of(flight, time), dict[str, Array]()
        if flight.lin_vel is not None:
            found["speed [m/s]"] = np.linalg.norm(flight.lin_vel[rows], axis=1)
        if flight.position is not None:
            found["height [m]"] = flight.position[rows, 2]
        parts.append(found | {"turn rate [rad/s]": np.linalg.norm(flight.ang_vel[rows], axis=1)})
    together = {title: np.concatenate(values) for title, values in had_by_all(parts).items()}
    return {
        title: (float(v[acts].mean()), float(v[~acts].mean()) if not acts.all() else np.nan)
        for title, v in together.items()
    }
