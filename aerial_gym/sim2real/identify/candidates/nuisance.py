"""Residual structure without a known effect, as nuisance columns: functions of place, heading and so on, or a tone.

A structure competes with effects by evidence, but corrects nothing. From functions that a known effect follows, the part
that it can produce is removed; the rest represents errors of its law. Letters: T rows, C channels, F functions, S flights.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.candidates.structure import (
    IN_WORLD,
    CommonLines,
    force_channel_indices,
    motion_features,
    rotate_residuals,
    structure_features,
)
from aerial_gym.sim2real.identify.least_squares.derivative_sums import SparseDerivatives
from aerial_gym.sim2real.identify.least_squares.moments import FlightOffsets, Weighting
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times

FORCES = ("specific_force", "kinematic_force")  # Kinds of channel with accelerometer readings
OF_FLIGHTS = "flight"  # Kind of the offsets of single flights


@dataclass(frozen=True, kw_only=True, eq=False)
class NuisanceColumns:
    """Columns of one kind of structure in one channel."""

    kind: str  # position, heading, velocity, voltage, time, periodic or flight
    channel: str  # Channel, or kind of channels with a common size; world axes for forces of position and heading
    columns: list[SparseDerivatives]  # F functions times ``size``, (T, C, F) of each flight
    size: float  # RMS of one unit in the channel's unit: the declared model's residual, or the scatter between flights
    most: float = np.inf  # Upper limit of ``size`` if it is the scatter between flights
    freq_hz: float | None = None  # Frequency of a tone [Hz]

    @property
    def is_flight_offset(self) -> bool:
        """Return whether it is an offset of single flights, which is no evidence against a set of effects."""
        return self.kind == OF_FLIGHTS

    @property
    def name(self) -> str:
        """Return the name among the candidates."""
        return f"{self.kind} in {self.channel}"


@dataclass(frozen=True, kw_only=True)
class _ChannelStructure:
    """Unit of structure in a channel, before removal of effects."""

    kind: str
    channel: str
    size: float
    functions: list[Array]  # Functions, (T, F)
    moved: tuple[int, ...]  # Affected channels
    axes: list[Array]  # Factors of the affected channels, (T, c)


class Nuisances:
    """All structures that the given flights can show."""

    def __init__(
        self, flights: Sequence[Flight], times: Sequence[Array], channels: Sequence[Channel], declared: Sequence[Array],
        most: Array,
    ) -> None:  # fmt: skip
        """Take flights, residuals of the declared model (T, C), which give sizes, and the largest flight offsets (C,)."""
        self._times, self._channels, self._declared, self._most = times, channels, declared, most
        motion = [motion_features(flight, time) for flight, time in zip(flights, times, strict=True)]
        self._lines = CommonLines(times, motion)
        self._shapes = list[_ChannelStructure]()
        alone, force = [np.ones((time.size, 1)) for time in times], force_channel_indices(channels)
        turns = [Rotation.from_quat(f.attitude[rows_at_times(f, time)]) for f, time in zip(flights, times, strict=True)]
        world = [[turn.apply(axis, inverse=True) for turn in turns] for axis in np.eye(3)]
        for kind, features in structure_features(flights, times).items():
            functions = _orthonormal_functions(features)
            if kind in IN_WORLD:  # a force at a place has a mean; for others, effects explain the mean
                functions = [np.column_stack((np.ones(len(part)), part)) for part in functions]
            if not functions[0].shape[1]:
                continue  # constant voltage
            seen = rotate_residuals(kind, flights, times, declared, channels)
            for place, channel in enumerate(channels):
                moved, axes = (place,), alone
                if kind in IN_WORLD and place in force:  # world axis in body coordinates
                    moved, axes = force, world[force.index(place)]
                size = _rms_over_all_flights([part[:, place] for part in seen])
                unit = {"kind": kind, "channel": channel.name, "size": size, "functions": functions}
                self._shapes.append(_ChannelStructure(**unit, moved=moved, axes=axes))

    def structures_beyond_effects(
        self, present: Sequence[Array], effects: Mapping[str, Sequence[Sequence[SparseDerivatives]]]
    ) -> list[NuisanceColumns]:
        """Return the structures without the parts that effects can produce.

        ``present``: residuals of the present model, (T, C), for tones. ``effects``: derivatives (T, C, any) of each effect
        by start.
        """
        matrices = []
        for shape in self._shapes:
            rivals = [part for name in effects if shape.kind in EFFECTS.get(name).follows for part in effects[name]]
            pairs = [zip(own, shape.axes, strict=True) for own in rivals]
            along = [[np.einsum("tck,tc->tk", p.dense_columns(shape.moved), axis) for p, axis in own] for own in pairs]
            beyond = zip(_functions_beyond_effects(shape.functions, along), shape.axes, strict=True)
            columns = [(shape.size * x[:, None] * axis[..., None]).astype(np.float32) for x, axis in beyond]
            parts = [SparseDerivatives(values=v, channels=shape.moved, width=v.shape[2]) for v in columns]
            matrices.append(NuisanceColumns(kind=shape.kind, channel=shape.channel, columns=parts, size=shape.size))
        return [*matrices, *_flight_offset_columns(self._channels, present, self._most), *self._tone_columns(present)]

    def _tone_columns(self, present: Sequence[Array]) -> list[NuisanceColumns]:
        """Return the strongest common tone of each channel, with a separate phase in each flight."""
        matrices, times = [], self._times
        for place, channel in enumerate(self._channels):
            line = self._lines.strongest_line([part[:, place] for part in present])
            if line is None:
                continue
            size, columns = _rms_over_all_flights([part[:, place] for part in self._declared]), []
            for number, time in enumerate(times):
                turn = 2.0 * np.pi * line[0] * time
                waves = size * np.sqrt(2.0) * np.column_stack((np.cos(turn), np.sin(turn)))[:, None]
                columns.append(_columns_of_one_flight(number, len(times), waves, (place,)))
            matrices.append(
                NuisanceColumns(kind="periodic", channel=channel.name, columns=columns, size=size, freq_hz=line[0])
            )
        return matrices


def prior_of_flight_offsets(
    structures: Sequence[NuisanceColumns], channels: Sequence[Channel], weight: Array
) -> FlightOffsets:
    """Return the flight offsets among some structures; ``weight``: weight of a row of each channel, (C,)."""
    own = {one.channel: (one.size, one.most) for one in structures if one.is_flight_offset}
    none = (0.0, 0.0)
    size, most = np.array([own.get(channel.name, own.get(channel.kind, none)) for channel in channels]).T
    return FlightOffsets(size=size, weight=weight, most=most)


def structure_functions(kind: str, flights: Sequence[Flight], times: Sequence[Array]) -> list[Array]:
    """Return functions of place, heading, time or another variable, with mean 0 and RMS 1 over all flights, (T, F)."""
    return _orthonormal_functions(structure_features(flights, times)[kind])


def gradient_functions(predictor: Predictor) -> dict[str, list[Array]]:
    """Return time and, where logged, position, with mean 0 and RMS 1 over all flights and orthogonal, (T, F) of each flight."""
    pairs, features = list(zip(predictor.flights, predictor.times, strict=True)), {}
    features["time"] = [time[:, None] for time in predictor.times]
    places = [(flight.position, rows_at_times(flight, time)) for flight, time in pairs]
    if all(position is not None for position, _ in places):
        features["position"] = [position[rows] for position, rows in places if position is not None]
    return {kind: _orthonormal_functions(parts) for kind, parts in features.items()}


def _orthonormal_functions(features: Sequence[Array]) -> list[Array]:
    """Return an orthogonal basis of the features' deviations from their means, with RMS 1 over all flights, (T, F)."""
    whole = np.concatenate(features)
    centred = (whole - whole.mean(axis=0)) / np.maximum(whole.std(axis=0), 1e-12)
    directions, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    kept = directions[:, sizes > 1e-3 * sizes[0]] * np.sqrt(len(whole)) if sizes[0] > 0.0 else directions[:, :0]
    return np.split(kept, np.cumsum([len(part) for part in features])[:-1])


def _functions_beyond_effects(functions: Sequence[Array], effects: Sequence[Sequence[Array]]) -> list[Array]:
    """Return functions (T, F) minus their least-squares fit by effects (T, any)."""
    if not effects:
        return list(functions)
    whole, ends = np.concatenate(functions), np.cumsum([len(part) for part in functions])[:-1]
    columns = np.column_stack([np.concatenate(own) for own in effects])
    made = columns @ np.linalg.lstsq(columns, whole, rcond=1e-6)[0]
    return np.split(whole - made, ends)


def limits_of_flight_offsets(predictor: Predictor, tolerated: Array) -> Array:
    """Return the largest offsets of single flights in each channel, (C,): ``tolerated`` plus that of an accelerometer.

    Larger differences are no offsets: flights in different winds differ by drag.
    """
    force = np.array([channel.kind in FORCES for channel in predictor.channels])
    if not all(flight.accelerometer for flight in predictor.flights):
        return np.where(force, 0.0, tolerated)
    return np.hypot(tolerated, force * predictor.tolerances.acc_of_flight)


def channels_with_common_offsets(channels: Sequence[Channel]) -> dict[str, list[int]]:
    """Return the indices of the channels whose flight offsets have one standard deviation: the axes of an accelerometer.

    A few flights may agree on one axis by chance, which would then look like a force on the vehicle.
    """
    results = dict[str, list[int]]()
    for place, channel in enumerate(channels):
        results.setdefault(channel.kind if channel.kind in FORCES else channel.name, []).append(place)
    return results


def _flight_offset_columns(channels: Sequence[Channel], present: Sequence[Array], most: Array) -> list[NuisanceColumns]:
    """Return an offset per flight and channel, of the flights' standard deviation up to ``most`` (C,)."""
    if len(present) < 2:
        return []
    stds = np.minimum(np.std([part.mean(axis=0) for part in present], axis=0, ddof=1), most)
    matrices = []
    for name, places in channels_with_common_offsets(channels).items():
        size, limit = (float(np.sqrt(np.mean(np.square(values[places])))) for values in (stds, most))
        if not size:
            continue
        columns = [
            _columns_of_one_flight(number, len(present), np.tile(size * np.eye(len(places)), (len(part), 1, 1)), places)
            for number, part in enumerate(present)
        ]
        matrices.append(NuisanceColumns(kind=OF_FLIGHTS, channel=name, columns=columns, size=size, most=limit))
    return matrices


def _columns_of_one_flight(flight: int, flights: int, values: Array, channels: Sequence[int]) -> SparseDerivatives:
    """Return the columns of one flight, (T, c, p), among equal numbers of columns for every flight."""
    own = values.shape[2]
    return SparseDerivatives(
        values=values.astype(np.float32), channels=tuple(channels), width=own * flights, first=own * flight
    )


def _rms_over_all_flights(parts: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def residuals_beyond_structures(
    structures: Sequence[NuisanceColumns], residuals: Sequence[Array], weights: Weighting
) -> list[Array]:
    """Return residuals (T, C) minus the structures, fitted channel by channel with unit normal priors."""
    left = [part.copy() for part in residuals]
    for place, weight in enumerate(weights.weight):
        own = [s.columns for s in structures if place in s.columns[0].channels]
        if not own:
            continue
        columns = [
            np.concatenate([p.dense_columns((place,))[:, 0] for p in parts], axis=1, dtype=np.float64)
            for parts in zip(*own, strict=True)
        ]
        product = sum(part.T @ part for part in columns)
        gradient = sum(part.T @ values[:, place] for part, values in zip(columns, residuals, strict=True))
        step = np.linalg.solve(weight * product + np.eye(columns[0].shape[1]), weight * gradient)
        for part, values in zip(columns, left, strict=True):
            values[:, place] -= part @ step
    return left
