"""Rows of flights: which are evaluated together, and vehicles and models of one environment in every one. Letters: E rows."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import torch

from aerial_gym.physics import Vehicle
from aerial_gym.physics.model import Model, in_steady_wind
from aerial_gym.sim2real.arrays import Indices
from aerial_gym.sim2real.logs.flights import Flight

MOST_ROWS = 16000
"""Flights are evaluated together up to so many rows: more of them leave the processor's cache, and take longer each."""


def together(rows: Sequence[int]) -> list[slice]:
    """Return which neighbouring flights are evaluated together, given the rows of each: MOST_ROWS, or a longer one alone."""
    ends = [0]
    for index in range(1, len(rows)):
        if sum(rows[ends[-1] : index + 1]) > MOST_ROWS:
            ends.append(index)
    return [slice(a, b) for a, b in pairwise([*ends, len(rows)])]


def expand_rows(vehicle: Vehicle, rows: int) -> Vehicle:
    """Return the vehicle of one environment in every row, without copies."""
    return vehicle.map_rows(lambda values: values.expand(rows, *values.shape[1:]))


def one_row(vehicle: Vehicle, row: int) -> Vehicle:
    """Return the vehicle of one of several environments."""
    return vehicle.map_rows(lambda values: values[row : row + 1])


def expand_model(model: Model, rows: int) -> Model:
    """Return the model of one environment in every row, without copies."""
    return replace(
        model,
        vehicle=expand_rows(model.vehicle, rows),
        inertia_inverse=model.inertia_inverse.expand(rows, 3, 3),
        effects=model.effects.with_params(lambda _, params: params.expand(rows, -1)),
    )


def with_known_wind(model: Model, flights: Sequence[Flight], flight: Indices) -> Model:
    """Return the model in the wind that was known in the flight of each row, on top of its own; ``flight`` is (E,)."""
    if all(f.wind is None for f in flights):
        return model
    known = torch.tensor([f.wind or (0.0, 0.0, 0.0) for f in flights], dtype=torch.float64)
    return in_steady_wind(model, known[torch.from_numpy(flight)])
