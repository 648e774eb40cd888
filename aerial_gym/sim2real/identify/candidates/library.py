"""Library of all testable candidates, linearised about a fitted model, as sums over time blocks.

Letters: B blocks, C channels, K columns (parameters of the candidates in units of their scale, then the tolerances).
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.candidates.nuisance import NuisanceColumns
from aerial_gym.sim2real.identify.least_squares.derivative_sums import (
    Part,
    SparseColumns,
    SparseDerivatives,
    drop_zero_channels,
    moments_by_channel,
    num_columns,
    weighted_moments,
)
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    Derivatives,
    correct_derivatives,
    effect_jacobian,
    is_continuous_parameter,
    linear_change,
    parameter_bounds,
    parameter_scales,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import UNIT, WEAK_PRIOR, Frozen
from aerial_gym.sim2real.identify.least_squares.moments import Moments
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

Structures = Callable[[list[Array], dict[str, list[list[SparseDerivatives]]]], Sequence[NuisanceColumns]]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One effect, or one effect on one rotor."""

    name: str
    named: bool  # Whether the selection has accepted it
    columns: Indices  # Free parameters, as indices of the K columns
    low: Array  # Lowest steps from neutral in units of the scale
    high: Array  # Highest steps from neutral in units of the scale
    start: Array = field(default_factory=lambda: np.zeros(0))  # All parameters at the linearisation
    structure: bool = False  # Whether it is a residual structure rather than an effect
    is_flight_offset: bool = False  # Whether it is a structure specific to each flight

    @property
    def is_common_structure(self) -> bool:
        """Return whether it is a structure common to all flights, which no robot file can represent."""
        return self.structure and not self.is_flight_offset


@dataclass(frozen=True, kw_only=True)
class Library:
    """Candidates about a model; the residual is that with all candidates at neutral."""

    candidates: tuple[Candidate, ...]
    moments: Moments  # Sums with every candidate at neutral
    weight: Array  # Weight of a row of each channel of the moments
    tolerances: Indices  # Indices of the tolerances among the K columns
    tangents: list["Tangent"] = field(default_factory=list)  # Linearisations, in the order of the candidates


@dataclass(frozen=True, kw_only=True)
class Tangent:
    """Linearisation of the prediction in the parameters of one effect."""

    name: str
    named: bool  # Whether the effect was fitted in that model
    start: Array  # All parameters at the linearisation, (P,)
    columns: list[SparseDerivatives]  # Derivatives by the parameters, per scale, (rows, C, P) of each flight

    @property
    def key(self) -> tuple[str, bytes]:
        """Return effect and start, which are the same for all flights."""
        return self.name, self.start.tobytes()

    def dense_derivatives(self, channels: int) -> Derivatives:
        """Return the derivatives of all C channels, zeros included, (rows, C, P) of each flight."""
        return [part.dense_columns(range(channels)) for part in self.columns]


def linearise_candidates(
    predictor: Predictor, declared: ModelParams, present: ModelParams, accepted: Sequence[str] = (),
    skipped: Collection[str] = (),
) -> list[Tangent]:  # fmt: skip
    """Return the linearisations of accepted effects at fitted values and others at neutral, as ``build_library``."""
    candidates, base = list[Tangent](), predictor.predict(present)
    for name, params in linearisation_points(declared, present, accepted, skipped, predictor.robot):
        named = params is present
        columns = effect_jacobian(predictor, params, (name,), base if named else predictor.predict(params))
        if all(np.isfinite(part).all() for part in columns):  # otherwise the load swings over the top in this model
            candidates.append(
                Tangent(name=name, named=named, start=params.effects[name], columns=drop_zero_channels(columns))
            )
    predictor.clear_caches()
    return candidates


def build_library(
    predictor: Predictor, declared: ModelParams, present: ModelParams, accepted: Sequence[str], weight: Array, *,
    frozen: Frozen = frozenset(), skipped: Collection[str] = (), structures: Structures | None = None,
    tangents: list[Tangent] | None = None, tolerance: SparseColumns | None = None, by_channel: bool = False,
    parts: int = 1,
) -> Library:  # fmt: skip
    """Return the library of all candidates about a model that contains some of them.

    Derivatives of accepted effects are at the fitted values, corrected to be exact back to neutral; those of others at
    neutral.

    Args:
        present: Model of the linearisation, in which ``accepted`` effects are fitted.
        weight: Weight of one row of each channel, (C,).
        frozen: Fixed parameters of accepted effects, which the flights do not determine.
        skipped: Effects that these flights cannot show.
        structures: Function of the present residuals and the derivatives by each effect at each start, (rows, C, any).
        tangents: Known linearisations of all candidates about the present model.
        tolerance: Derivatives by each deviation, (rows, C), about a nearby model; None: computed here.
        by_channel: Whether moments are unweighted, by channel and flight; not with structures.
        parts: Number of parts of each flight.
    """
    if tangents is None:
        tangents = linearise_candidates(predictor, declared, present, accepted, skipped)
    base = predictor.predict(present)
    residuals = here = [m - p for m, p in zip(predictor.measured, base, strict=True)]
    candidates, width = list[Candidate](), 0
    derivatives, own = list[Sequence[Part]](), dict[str, list[list[SparseDerivatives]]]()
    for tangent in tangents:
        name, named, columns = tangent.name, tangent.named, tangent.columns
        neutral, scale = neutral_params(name, declared, predictor.robot), parameter_scales((name,))
        if named:  # back to neutral
            step = (tangent.start - neutral) / scale
            exact = [part.astype(np.float64) for part in tangent.dense_derivatives(len(predictor.channels))]
            change = [b - n for b, n in zip(base, predictor.predict(present.with_effect(name, neutral)), strict=True)]
            correct_derivatives(exact, step, change)
            residuals = [r + linear_change(c, step) for r, c in zip(residuals, exact, strict=True)]
            columns = drop_zero_channels(exact)
        free = [
            k for k in range(scale.size) if is_continuous_parameter(name, k) and not (named and (name, k) in frozen)
        ]
        low, high = (((bound - neutral) / scale)[free] for bound in parameter_bounds(predictor.robot, (name,)))
        places = np.array(free, dtype=int) + width
        candidates.append(Candidate(name=name, named=named, columns=places, low=low, high=high, start=tangent.start))
        derivatives.append(columns)
        width += scale.size
        own.setdefault(name, []).append(columns)
    for structure in () if structures is None else structures(here, own):
        places = np.arange(structure.columns[0].width) + width
        open_end = np.full(places.size, np.inf)
        bounds, own_of_flights = {"low": -open_end, "high": open_end}, structure.is_flight_offset
        candidate = Candidate(
            name=structure.name, named=False, columns=places, structure=True, is_flight_offset=own_of_flights, **bounds
        )
        candidates.append(candidate)
        derivatives.append(structure.columns)
        width += places.size
    derivatives += [tolerance_jacobian(predictor, present, np.float32)] if tolerance is None else tolerance
    flights = list(zip(*derivatives, strict=True))
    if by_channel:
        moments = moments_by_channel(residuals, flights)
    else:
        moments = weighted_moments(predictor.times, residuals, flights, weight, parts=parts)
    give_back_memory()
    tolerances = np.arange(width, num_columns(flights[0]))
    weight = weight if by_channel else UNIT
    return Library(
        candidates=tuple(candidates), moments=moments, weight=weight, tolerances=tolerances, tangents=tangents
    )


def linearisation_points(
    declared: ModelParams, present: ModelParams, accepted: Sequence[str], skipped: Collection[str], robot: RobotCfg
) -> list[tuple[str, ModelParams]]:
    """Return each candidate with the model of its linearisation, the present one for accepted effects.

    Laws that are fitted only in place of others are none, and no others of the cause beside an accepted one of them.
    """
    candidates, effects = [], {name: EFFECTS.get(name) for name in EFFECTS}
    in_place = {name for name, effect in effects.items() if effect.in_place}
    skipped = {*skipped, *in_place, *(law for name in in_place.intersection(accepted) for law in law_relatives(name))}
    for name in (name for name, effect in effects.items() if effect.is_candidate_of_selection):
        if name in accepted:
            candidates.append((name, present))
        if name in skipped and name not in accepted:
            continue
        for params in starts_of_effect(name, present, declared, robot):
            if name not in accepted or (is_of_one_rotor(name) and params.effects[name][0] != present.effects[name][0]):
                candidates.append((name, params))
    return candidates


def starts_of_effect(name: str, params: ModelParams, declared: ModelParams, robot: RobotCfg) -> list[ModelParams]:
    """Return the models in which fits of an effect start: at neutral, once for each start or rotor."""
    if name in declared.effects:
        return [params.with_effect(name, declared.effects[name])]
    return [params.with_effect(name, np.array(start)) for start in EFFECTS.get(name).starts(robot)]


def has_several_starts(name: str, robot: RobotCfg) -> bool:
    """Return whether fits of an effect have several starts."""
    return len(EFFECTS.get(name).starts(robot)) > 1


def law_relatives(name: str) -> tuple[str, ...]:
    """Return the effects that cannot act beside an effect: other laws of its cause, its special cases and generalisations."""
    own = EFFECTS.get(name)
    laws = ((other, EFFECTS.get(other)) for other in EFFECTS if other != name)
    return tuple(
        other for other, law in laws if law.cause == own.cause or other in own.contains or name in law.contains
    )


def is_of_one_rotor(name: str) -> bool:
    """Return whether an effect acts on one rotor."""
    return any(parameter.kind == "rotor" for parameter in EFFECTS.get(name).parameters)


def neutral_params(name: str, declared: ModelParams, robot: RobotCfg) -> Array:
    """Return the parameters at which an effect changes nothing: declared ones, else its neutral values."""
    if name in declared.effects:
        return declared.effects[name]
    return np.array(EFFECTS.get(name).neutral(robot), dtype=float)


def observable_candidates(library: Library) -> tuple[Candidate, ...]:
    """Return the candidates without weakly identifiable parameters (deviation above one scale); accepted ones are complete."""
    product = np.einsum("c,bckl->kl", library.weight, library.moments.product)
    candidates = []
    for candidate in library.candidates:
        if candidate.named or not candidate.columns.size:
            candidates.append(candidate)
            continue
        # Accepted effects are omitted, since a candidate that could replace one would seem unidentifiable.
        columns = np.concatenate((candidate.columns, library.tolerances))
        precision = np.repeat((WEAK_PRIOR**-2, 1.0), (candidate.columns.size, library.tolerances.size))
        bread = np.linalg.inv(product[np.ix_(columns, columns)] + np.diag(precision))
        kept = np.diag(bread)[: candidate.columns.size] <= 1.0
        columns, low, high = candidate.columns[kept], candidate.low[kept], candidate.high[kept]
        candidates.append(replace(candidate, columns=columns, low=low, high=high))
    return tuple(candidate for candidate in candidates if candidate.columns.size)
