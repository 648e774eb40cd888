"""Before and after in parts: per flight, and in the regime in which an effect acts.

Letters: T rows, C channels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerial_gym.sim2real.identify.least_squares.moments import time_groups
from aerial_gym.sim2real.identify.selection.library import neutral_of
from aerial_gym.sim2real.judge.evaluation import Evaluation, gap_closed
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import KINEMATIC, UNITS
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES
from aerial_gym.sim2real.statistics import Rms, rms_with_interval

Array = NDArray[np.float64]

ACTS_FROM = 0.75
"""An effect acts in the rows in which its contribution is above this quantile."""

ROLLOUT_S = 1.0
"""Horizon that stands for rollouts in a table by flights [s]."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """One quantity before and after."""

    quantity: str
    unit: str
    before: Rms
    after: Rms


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
        return {
            "channel": self.channel,
            "before": self.before.as_mapping(),
            "after": self.after.as_mapping(),
            "gap_closed": self.gap_closed,
        }


def by_flight(
    predictor: Predictor, declared: ModelParams, final: ModelParams, before: Evaluation, after: Evaluation, *, seed: int
) -> dict[str, list[Part]]:
    """Return the residual of each kind of channel (rms of its vector) and the rollout at 1 s, of each flight."""
    kinds = [kind for kind in dict.fromkeys(c.kind for c in predictor.channels) if kind not in KINEMATIC]
    residuals = predictor.residuals(declared), predictor.residuals(final)
    found: dict[str, list[Part]] = {}
    for index, flight in enumerate(predictor.flights):
        group, parts = time_groups([predictor.times[index]]), []
        for kind in kinds:
            places = [place for place, channel in enumerate(predictor.channels) if channel.kind == kind]
            lengths = [np.linalg.norm(part[index][:, places], axis=1)[:, None] for part in residuals]
            rms = [rms_with_interval(length, group, seed=seed)[0] for length in lengths]
            parts.append(Part(quantity=kind.replace("_", " "), unit=UNITS[kind], before=rms[0], after=rms[1]))
        found[flight.name] = parts + _rollout_parts(index, before, after, seed)
    return found


def _rollout_parts(index: int, before: Evaluation, after: Evaluation, seed: int) -> list[Part]:
    parts = []
    if "free" not in before.rollouts or ROLLOUT_S not in before.rollouts["free"].horizons:
        return []
    errors = before.rollouts["free"], after.rollouts["free"]
    own = errors[0].windows.flight == index
    column = errors[0].horizons.index(ROLLOUT_S)
    for quantity, unit in QUANTITIES.items():
        values = [getattr(error, quantity) for error in errors]
        if values[0] is not None and own.any():
            cluster = errors[0].windows.cluster[own]
            rms = [rms_with_interval(v[own][:, column : column + 1], cluster, seed=seed)[0] for v in values]
            title = f"{quantity} after {ROLLOUT_S:g} s"
            parts.append(Part(quantity=title, unit=unit, before=rms[0], after=rms[1]))
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
        rms_with_interval(np.concatenate(predictor.residuals(point))[acts][:, place : place + 1], group, seed=seed)[0]
        for point in (declared, final)
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


def _looks(
    flights: Sequence[Flight], times: Sequence[Array], acts: NDArray[np.bool_]
) -> dict[str, tuple[float, float]]:
    """Return means over the rows in which an effect acts and over the others."""
    rows = [np.round(time * flight.rate).astype(int) for flight, time in zip(flights, times, strict=True)]
    found = {}
    if all(flight.lin_vel is not None for flight in flights):
        found["speed [m/s]"] = [
            np.linalg.norm(f.lin_vel[r], axis=1) for f, r in zip(flights, rows, strict=True) if f.lin_vel is not None
        ]
    if all(flight.position is not None for flight in flights):
        found["height [m]"] = [f.position[r, 2] for f, r in zip(flights, rows, strict=True) if f.position is not None]
    found["turn rate [rad/s]"] = [np.linalg.norm(f.ang_vel[r], axis=1) for f, r in zip(flights, rows, strict=True)]
    together = {title: np.concatenate(parts) for title, parts in found.items()}
    return {
        title: (float(v[acts].mean()), float(v[~acts].mean()) if not acts.all() else np.nan)
        for title, v in together.items()
    }
