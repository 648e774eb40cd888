"""What remains beside the named effects: more than noise and tolerances, random wind, or a structure that no effect has.

Letters: C channels, N tolerances, T rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.identify.candidates.structure import Structure, find_structure
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit, best_step
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.evaluation import Evaluation
from aerial_gym.sim2real.judge.predictive import Asked, left_open, names_of, open_effects
from aerial_gym.sim2real.judge.random_wind.gusts import RandomWind, declared_wind, find_random_wind
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import KINEMATIC
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

NEAR_FLOOR = 2.0
"""A mean square of less than this many times the floor's is near the noise floor."""

TOLERATED = 0.5
"""What remains above the floor is immaterial below this share of what the vehicle's tolerances may cause."""


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """What the named effects leave of the test flights."""

    within: ModelParams
    """The final model with the deviations within the tolerances that fit best."""

    left: list[Array]
    """Residuals of each test flight with them, (T, C)."""

    channels: tuple[str, ...]
    """In which more than noise and tolerances remains."""

    left_open: tuple[str, ...]
    """In which more than noise remains, and no more than training flights leave open of the tolerances and named effects."""

    of_flights: tuple[str, ...]
    """In which more than noise remains, and that is an offset of each flight's own, as training flights have them."""

    open_to: tuple[str, ...]
    """Effects that would make what remains in ``channels`` and that training flights do not show well enough to tell."""

    floor: Array | None
    """Noise floor of each channel, random wind included, (C,); None where the logs show none."""

    wind: RandomWind
    structure: Structure

    @property
    def deviation(self) -> Array:
        """Return these deviations, in standard deviations, (N,)."""
        assert self.within.deviation is not None
        return self.within.deviation

    def above_its_floor(self, found: Evaluation) -> Evaluation:
        """Return an evaluation against the noise floor with random wind in it, if there is any."""
        return (
            replace(found, floor=tuple(self.floor.tolist())) if self.wind.accepted and self.floor is not None else found
        )


def find_unexplained(
    train: Predictor,
    test: Predictor,
    selection: SelectionResult,
    models: tuple[ModelParams, ModelParams],
    after: Evaluation,
    floor: Array | None,
) -> Unexplained:
    """Return what the final model leaves of the test flights.

    Args:
        train: Training flights.
        test: Test flights.
        selection: The selection.
        models: The declared and the final one, as the robot files hold them.
        after: What the corrected model leaves of the test flights, without deviations.
        floor: Noise floor of each channel, (C,).
    """
    _, params = models
    flights = [*train.flights, *test.flights]
    within = with_best_deviations(params, selection.final.fit, selection.weights.weight)
    left, tolerated = test.residuals(within), selection.left_out.tolerated
    rms = np.minimum(rms_of(left), [channel.value for channel in after.residual])  # tolerances only ever explain
    judged = np.array([channel.kind not in not_judged(flights) for channel in test.channels])
    suspected = judged & material_excess(rms, floor, tolerated)
    seen, own = train.residuals(within), selection.own_offsets.size > 0.0

    def about_offsets(parts: list[Array]) -> Array:
        return rms_of([part - own * part.mean(axis=0) for part in parts])

    fitted = ~material_excess(about_offsets(seen), floor, tolerated)
    about = np.where(own, about_offsets(left), rms)
    within_flights = whole = np.zeros(rms.size)
    if suspected.any():
        within_flights, whole = left_open(test, params, selection, fitted)

    def unexplained_above(floor: Array | None) -> Flags:
        cases = ((about, within_flights), (rms, whole))
        return suspected & np.any(
            [material_excess(rms, floor, tolerated) & (excess_over(rms, floor) > limit) for rms, limit in cases],
            axis=0,
        )

    remaining, wind = unexplained_above(floor), declared_wind(train.robot)
    if not wind.accepted:
        wind = find_random_wind(
            train, within, selection.criteria, floor=floor, tolerated=tolerated, remaining=remaining
        )
        if wind.accepted and floor is not None:
            floor = np.hypot(floor, wind.adds(test, params))
            remaining = unexplained_above(floor)
    structure, could = Structure(), ()
    if remaining.any():
        places = np.flatnonzero(remaining).tolist()
        structure = find_structure(flights, [*train.times, *test.times], [*seen, *left], test.channels, places)
        if structure.kind == "none":  # test flights may be elsewhere, where what the others agree on does not reach
            structure = find_structure(train.flights, train.times, seen, test.channels, places)
        level = floor  # of the noise, random wind included
        asked = Asked(remaining=remaining, enough=lambda rms: ~material_excess(rms, level, tolerated))
        could = open_effects(train, test, models, selection, asked)
    names = [channel.name for channel in test.channels]
    open_channels = suspected & material_excess(rms, floor, tolerated) & ~remaining
    offsets = open_channels & own & ~material_excess(about, floor, tolerated)
    return Unexplained(
        within=within,
        left=left,
        channels=names_of(names, remaining),
        left_open=names_of(names, open_channels & ~offsets),
        of_flights=names_of(names, offsets),
        open_to=could,
        floor=floor,
        wind=wind,
        structure=structure,
    )


def rms_of(parts: Sequence[Array]) -> Array:
    """Return the root of the mean square of each column of some parts (rows, C), (C,)."""
    return np.sqrt(np.mean(np.square(np.concatenate(parts)), axis=0))


def with_best_deviations(params: ModelParams, fit: Fit, weight: Array) -> ModelParams:
    """Return a model with the deviations within the tolerances that fit the training flights best beside its own effects.

    Args:
        params: The final model, as the robot file holds it.
        fit: Its linearisation on the training flights.
        weight: Of one row of each channel, (C,).
    """
    own = fit.num_effect_params
    step = best_step(fit, weight, np.arange(own, fit.low.size))
    return replace(params, deviation=step[own:])


def material_excess(rms: Array, floor: Array | None, tolerated: Array) -> Flags:
    """Return in which channels more remains than noise and tolerances, (C,); all False where no floor is known.

    Args:
        rms: Residual with effects and with the deviations that fit best within the tolerances, (C,).
        floor: Noise floor, (C,).
        tolerated: Residual that the tolerances of the vehicle cause, (C,).
    """
    if floor is None:
        return np.zeros(rms.size, dtype=bool)
    return (rms**2 > NEAR_FLOOR * floor**2) & (np.sqrt(excess_over(rms, floor)) > TOLERATED * tolerated)


def excess_over(rms: Array, floor: Array | None) -> Array:
    """Return the mean square above the noise floor, (C,); zeros where none is known."""
    return np.zeros(rms.size) if floor is None else np.maximum(rms**2 - floor**2, 0.0)


def judges_forces(flights: Sequence[Flight]) -> bool:
    """Return whether the airspeed is known, without which what remains of a force says nothing."""
    return all(flight.lin_vel is not None for flight in flights)


def not_judged(flights: Sequence[Flight]) -> tuple[str, ...]:
    """Return the kinds of channel in which what remains says nothing: kinematic ones, and forces at an unknown airspeed."""
    return KINEMATIC if judges_forces(flights) else (*KINEMATIC, "specific_force")
