"""The test residual beyond noise and tolerances: unexplained channels, random wind, or a structure that no effect has.

Letters: C channels, N tolerances, T rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.identify.candidates.structure import Structure, find_structure
from aerial_gym.sim2real.identify.least_squares.gauss_newton import ModelFit, least_squares_step_in_bounds
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation
from aerial_gym.sim2real.judge.predictive import (
    ResidualCriterion,
    channel_names,
    effects_left_open,
    largest_open_squares,
)
from aerial_gym.sim2real.judge.random_wind.gusts import RandomWind, find_random_wind, random_wind_in_file
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import KINEMATIC, Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

NEAR_FLOOR = 2.0
"""Ratio of the residual's mean square to that of the noise floor, below which the residual is near the floor."""

TOLERATED = 0.5
"""Share of the residual (rms) caused by tolerances, below which an excess over the noise floor is immaterial."""


@dataclass(frozen=True, kw_only=True)
class ResidualExcess:
    """The test residual of the final model, sorted by its possible origin."""

    within: ModelParams  # The final model with the deviations within the tolerances that fit best
    left: list[Array]  # Residuals of each test flight with these deviations, (T, C)
    channels: tuple[str, ...]  # Unexplained channels: the residual exceeds noise and the uncertainty of the parameters

    left_open: tuple[str, ...]
    """Channels whose residual exceeds noise, but not the parameter uncertainty that training leaves."""

    of_flights: tuple[str, ...]
    """Channels whose residual exceeds noise only by an offset of each flight, as in the training flights."""

    open_to: tuple[str, ...]
    """Effects that would explain the residual in ``channels`` and that training flights do not rule out."""

    floor: Array | None  # Noise floor of each channel, random wind included, (C,); None where the logs show none

    wind: RandomWind
    structure: Structure

    @property
    def deviation(self) -> Array:
        """Return the deviations within the tolerances that fit best, in standard deviations, (N,)."""
        assert self.within.deviation is not None
        return self.within.deviation

    def evaluation_with_wind_floor(self, evaluation: ModelEvaluation) -> ModelEvaluation:
        """Return an evaluation whose noise floor includes random wind, if random wind is accepted."""
        if self.floor is None or not self.wind.is_accepted:
            return evaluation
        return replace(evaluation, floor=tuple(self.floor.tolist()))


def find_residual_excess(
    train: Predictor, test: Predictor, selection: SelectionResult, models: tuple[ModelParams, ModelParams],
    after: ModelEvaluation, floor: Array | None,
) -> ResidualExcess:  # fmt: skip
    """Return the test residual of the final model with its unexplained and open channels, random wind and structure.

    Args:
        after: Evaluation of the corrected model on the test flights, without deviations.
        floor: Noise floor of each channel, (C,).
    """
    _, params = models
    flights = [*train.flights, *test.flights]
    within = model_with_training_deviations(params, selection.fit, selection.weights.weight)
    left, tolerated = test.residuals(within), selection.tolerated
    rms = np.minimum(channel_rms(left), [channel.value for channel in after.residual])  # deviations may only lower it
    suspected = is_judged(test.channels, flights) & is_material_excess(rms, floor, tolerated)
    seen, own = train.residuals(within), selection.flight_offsets.size > 0.0

    def about_offsets(parts: list[Array]) -> Array:
        return channel_rms([part - own * part.mean(axis=0) for part in parts])

    fitted = ~is_material_excess(about_offsets(seen), floor, tolerated)
    about = np.where(own, about_offsets(left), rms)
    within_flights = whole = np.zeros(rms.size)
    if suspected.any():
        within_flights, whole = largest_open_squares(test, params, selection, fitted)

    def excess_channels(floor: Array | None) -> Flags:
        cases = ((about, within_flights), (rms, whole))
        excess = [
            is_material_excess(rms, floor, tolerated) & (excess_power(rms, floor) > limit) for rms, limit in cases
        ]
        return suspected & np.any(excess, axis=0)

    remaining, wind = excess_channels(floor), random_wind_in_file(train.robot)
    if not wind.is_accepted:
        limits = {"floor": floor, "tolerated": tolerated, "remaining": remaining}
        wind = find_random_wind(train, within, selection.criteria, **limits)
        if wind.is_accepted and floor is not None:
            floor = np.hypot(floor, wind.channel_rms(test, params))
            remaining = excess_channels(floor)
    structure, could = Structure(), ()
    if remaining.any():
        places = np.flatnonzero(remaining).tolist()
        structure = find_structure(flights, [*train.times, *test.times], [*seen, *left], test.channels, places)
        if structure.kind == "none":  # test flights may cover another range, where the structure differs
            structure = find_structure(train.flights, train.times, seen, test.channels, places)
        level = floor  # of the noise, random wind included
        asked = ResidualCriterion(remaining=remaining, enough=lambda rms: ~is_material_excess(rms, level, tolerated))
        could = effects_left_open(train, test, models, selection, asked)
    names = [channel.name for channel in test.channels]
    open_channels = suspected & is_material_excess(rms, floor, tolerated) & ~remaining
    offsets = open_channels & own & ~is_material_excess(about, floor, tolerated)
    return ResidualExcess(
        within=within, left=left, channels=channel_names(names, remaining),
        left_open=channel_names(names, open_channels & ~offsets), of_flights=channel_names(names, offsets),
        open_to=could, floor=floor, wind=wind, structure=structure,
    )  # fmt: skip


def channel_rms(parts: Sequence[Array]) -> Array:
    """Return the rms of each column over all parts (rows, C) together, (C,)."""
    return np.sqrt(np.mean(np.square(np.concatenate(parts)), axis=0))


def model_with_training_deviations(params: ModelParams, fit: ModelFit, weight: Array) -> ModelParams:
    """Return a model with the deviations within the tolerances that fit the training flights best beside its own effects."""
    own = fit.num_effect_params
    step = least_squares_step_in_bounds(fit, weight, np.arange(own, fit.low.size))
    return replace(params, deviation=step[own:])


def is_material_excess(rms: Array, floor: Array | None, tolerated: Array) -> Flags:
    """Return whether the residual of each channel exceeds noise and tolerances, (C,); False if no floor is known.

    Args:
        rms: Residual with effects and with the deviations that fit best within the tolerances, (C,).
        tolerated: Residual (rms) that the tolerances of the vehicle cause, (C,).
    """
    if floor is None:
        return np.zeros(rms.size, dtype=bool)
    return (rms**2 > NEAR_FLOOR * floor**2) & (np.sqrt(excess_power(rms, floor)) > TOLERATED * tolerated)


def excess_power(rms: Array, floor: Array | None) -> Array:
    """Return the mean square above the noise floor, (C,); zeros where none is known."""
    return np.zeros(rms.size) if floor is None else np.maximum(rms**2 - floor**2, 0.0)


def is_judged(channels: Sequence[Channel], flights: Sequence[Flight]) -> Flags:
    """Return whether a residual in each channel is judged, (C,): not kinematics, nor forces in unknown air."""
    not_judged = KINEMATIC if can_judge_forces(flights) else (*KINEMATIC, "specific_force")
    return np.array([channel.kind not in not_judged for channel in channels])


def can_judge_forces(flights: Sequence[Flight]) -> bool:
    """Return whether every flight has velocity: without it drag is unknown, and force residuals are not judged."""
    return all(flight.lin_vel is not None for flight in flights)
