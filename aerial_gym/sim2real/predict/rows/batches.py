"""Batches of flights, and the expansion of one environment to every row. Letters: E rows."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import torch

from aerial_gym.physics import Vehicle
from aerial_gym.physics.model import Model, add_steady_wind
from aerial_gym.sim2real.arrays import Indices
from aerial_gym.sim2real.logs.flights import Flight

MOST_ROWS = (
    16000  # Most rows per batch, but for half a flight; larger ones exceed the processor's cache and are slower per row
)


def group_flights(rows: Sequence[int]) -> list[slice]:
    """Return the batches of consecutive flights, given their numbers of rows: of about MOST_ROWS at most, or one longer flight.

    Several batches are of similar size and even in number, so that two cores finish together.
    """
    ends, count = np.cumsum(rows), -(-sum(rows) // MOST_ROWS)
    count += count % 2 if count > 1 else 0
    marks = {int(np.abs(ends - ends[-1] * k / count).argmin()) + 1 for k in range(1, count)}
    return [slice(a, b) for a, b in pairwise(sorted({0, len(rows), *marks}))]


def expand_vehicle(vehicle: Vehicle, rows: int) -> Vehicle:
    """Return a vehicle of one environment expanded to every row, without copies."""
    return vehicle.map_rows(lambda values: values.expand(rows, *values.shape[1:]))


def vehicle_of_row(vehicle: Vehicle, row: int) -> Vehicle:
    """Return one environment of a vehicle."""
    return vehicle.map_rows(lambda values: values[row : row + 1])


def expand_model(model: Model, rows: int) -> Model:
    """Return a model of one environment expanded to every row, without copies."""
    vehicle, inverse = expand_vehicle(model.vehicle, rows), model.inertia_inverse.expand(rows, 3, 3)
    effects = model.effects.with_params(lambda _, params: params.expand(rows, -1))
    return replace(model, vehicle=vehicle, inertia_inverse=inverse, effects=effects)


def add_known_wind(model: Model, flights: Sequence[Flight], flight: Indices) -> Model:
    """Return the model with the known steady wind of each row's flight added; ``flight``: flight index, (E,)."""
    if all(f.wind is None for f in flights):
        return model
    known = torch.tensor([f.wind or (0.0, 0.0, 0.0) for f in flights], dtype=torch.float64)
    return add_steady_wind(model, known[torch.from_numpy(flight)])
