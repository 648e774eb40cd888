"""Errors of the declared and the corrected model, by flight and in the rows in which an effect acts most.

Letters: T rows, C channels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.identify.candidates.library import neutral_params
from aerial_gym.sim2real.identify.least_squares.moments import time_block_of_rows
from aerial_gym.sim2real.json_values import select_fields
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation, gap_closed
from aerial_gym.sim2real.judge.outcome import Outcome
from aerial_gym.sim2real.logs.flights import Flight, values_in_all_mappings
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times
from aerial_gym.sim2real.statistics import Rise, Rms, rise_with_interval, rms_with_interval

ACTS_FROM = 0.75  # An effect acts in the rows in which its contribution is above this quantile
ROLLOUT_S = 1.0  # Rollout horizon that the table by flight shows [s]


@dataclass(frozen=True)
class FlightError:
    """One error of one flight, with the declared model (before) and the corrected one (after)."""

    unit: str
    before: Rms
    after: Rms
    floor: float | None  # Noise floor (rms) of a channel on this flight; None where it is not known
    became: Outcome  # Name of the error, and its change on this flight

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        results = {"before": self.before.value, "after": self.after.value, "noise_floor": self.floor}
        return {**results, **self.became.as_mapping()}


@dataclass(frozen=True)
class ErrorsWhereActive:
    """The rows of the test flights in which an effect acts most."""

    channel: str  # Channel in which the effect's weighted mean-square contribution is largest

    unit: str
    before: Rms
    after: Rms
    gap_closed: float | None  # Share of the mean square above the noise floor that the correction removes in these rows

    looks: dict[str, tuple[float, float]]
    """Mean speed [m/s], height [m] and turn rate [rad/s] in these rows, and in the others."""

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return select_fields(self, "channel", "before", "after", "gap_closed")


def errors_by_flight(
    predictor: Predictor, models: tuple[ModelParams, ModelParams], evaluations: tuple[ModelEvaluation, ModelEvaluation],
    floors: Sequence[Array | None], *, least: float, seed: int,
) -> dict[str, list[FlightError]]:  # fmt: skip
    """Return the errors of the declared and the corrected model in each channel and in the free rollout at 1 s, by flight."""
    before, after = (predictor.residuals(model) for model in models)
    results: dict[str, list[FlightError]] = {}
    for index, flight in enumerate(predictor.flights):
        floor = floors[index]
        level = [None] * len(predictor.channels) if floor is None else floor.tolist()
        changes = _rms_and_rises(before[index], after[index], time_block_of_rows([predictor.times[index]]), seed)
        results[flight.name] = [
            FlightError(channel.unit, *rms, own, Outcome(quantity=channel.name, rise=rise, least=least))
            for channel, own, (rms, rise) in zip(predictor.channels, level, changes, strict=True)
        ] + _rollout_errors(index, evaluations, least, seed)
    return results


def _rms_and_rises(before: Array, after: Array, group: Indices, seed: int) -> list[tuple[tuple[Rms, Rms], Rise]]:
    """Return the rms of each column before and after, and its relative rise, of errors (T, C) each."""
    rms = zip(*(rms_with_interval(values, group, seed=seed) for values in (before, after)), strict=True)
    rises = rise_with_interval(after, before, group, np.zeros(len(before), dtype=np.int64))
    return list(zip(rms, rises, strict=True))


def _rollout_errors(
    index: int, evaluations: tuple[ModelEvaluation, ModelEvaluation], least: float, seed: int
) -> list[FlightError]:
    if "free" not in evaluations[0].rollouts or ROLLOUT_S not in evaluations[0].rollouts["free"].horizons:
        return []
    before, after = (evaluation.rollouts["free"] for evaluation in evaluations)
    own, column, parts = before.windows.flight == index, before.horizons.index(ROLLOUT_S), []
    for quantity, unit in QUANTITIES.items():
        old, new = getattr(before, quantity), getattr(after, quantity)
        if old is None or not own.any():
            continue
        at = slice(column, column + 1)
        ((rms, rise),) = _rms_and_rises(old[own, at], new[own, at], before.windows.cluster[own], seed)
        became = Outcome(quantity=f"free.{quantity}", horizon=ROLLOUT_S, rise=rise, least=least)
        parts.append(FlightError(unit, *rms, None, became))
    return parts


def errors_where_effect_acts(
    predictor: Predictor, declared: ModelParams, final: ModelParams, name: str, weight: Array, floor: Array | None, *,
    seed: int,
) -> ErrorsWhereActive:  # fmt: skip
    """Return the errors of both models in the rows in which an effect changes the prediction most.

    The effect's contribution is the final prediction minus the one with its parameters at neutral. Rows are ranked by the
    sum of its squares over all channels, weighted by ``weight`` (C,).
    """
    neutral = final.with_effect(name, neutral_params(name, declared, predictor.robot))
    change = np.concatenate([a - b for a, b in zip(predictor.predict(final), predictor.predict(neutral), strict=True)])
    size = np.sqrt((weight * change**2).sum(axis=1))
    acts = size >= np.quantile(size, ACTS_FROM)
    place = int(np.argmax(weight * (change[acts] ** 2).mean(axis=0)))
    group = time_block_of_rows(predictor.times)[acts]
    before, after = (
        rms_with_interval(np.concatenate(predictor.residuals(params))[acts][:, place : place + 1], group, seed=seed)[0]
        for params in (declared, final)
    )
    channel = predictor.channels[place]
    closed = gap_closed(before.value, after.value, None if floor is None else float(floor[place]))
    conditions = _mean_flight_conditions(predictor.flights, predictor.times, acts)
    return ErrorsWhereActive(channel.name, channel.unit, before, after, closed, conditions)


def _mean_flight_conditions(
    flights: Sequence[Flight], times: Sequence[Array], acts: Flags
) -> dict[str, tuple[float, float]]:
    """Return mean speed, height and turn rate over the rows in which an effect acts, and over the others."""
    parts = []
    for flight, time in zip(flights, times, strict=True):
        rows, results = rows_at_times(flight, time), dict[str, Array]()
        if flight.lin_vel is not None:
            results["speed [m/s]"] = np.linalg.norm(flight.lin_vel[rows], axis=1)
        if flight.position is not None:
            results["height [m]"] = flight.position[rows, 2]
        parts.append(results | {"turn rate [rad/s]": np.linalg.norm(flight.ang_vel[rows], axis=1)})
    together = {title: np.concatenate(values) for title, values in values_in_all_mappings(parts).items()}
    return {
        title: (float(v[acts].mean()), float(v[~acts].mean()) if not acts.all() else np.nan)
        for title, v in together.items()
    }
