"""Moments of synthetic fleets, computed from explicit measurements ``y = J x + noise`` with unit noise."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerial_gym.fleet.statistics import FleetModel, VehicleFlights
from aerial_gym.sim2real.arrays import Array

Truth = Callable[[int], Array]


def make_columns(*effects: tuple[str, str, int] | str, tolerances: int = 0, scale: float = 0.05) -> list[Any]:
    """Return columns of effects, ``(effect, parameter, rotor)`` or an effect's name alone, then of tolerances."""
    triples = [(one, "scale", 0) if isinstance(one, str) else one for one in effects]
    columns = [
        SimpleNamespace(effect=effect, parameter=name, rotor=rotor, start=0, scale=scale, neutral=1.0)
        for effect, name, rotor in triples
    ]
    return columns + [
        SimpleNamespace(effect="", parameter=f"t{k}", rotor=0, start=0, scale=1.0, neutral=0.0)
        for k in range(tolerances)
    ]


def make_model(columns: int, *, mean: Any = 0.0, vehicle: Any = 0.3, flight: Any = 0.05) -> FleetModel:
    """Return a model from standard deviations."""
    one = np.ones(columns)
    return FleetModel(
        mean=mean * one, var_vehicle=np.square(vehicle * one), var_flight=np.square(flight * one), mean_var=0.0 * one
    )


def make_flights(
    rng: np.random.Generator, model: FleetModel, flights: int, *, rows: int = 40, change: Array | None = None,
    mixing: Array | None = None, vehicle: str = "v", deviation: Array | None = None, scatter: Array | None = None,
) -> VehicleFlights:  # fmt: skip
    """Return the flights of one vehicle of a model.

    Args:
        change: Added to the parameters of each flight, (N, K).
        mixing: Matrix by which standard normal derivatives are multiplied, (K, K).
        deviation: Deviation of the vehicle from the mean, (K,); drawn by default.
        scatter: Deviations of its flights, (N, K); drawn by default.
    """
    width = model.mean.size
    own = np.sqrt(model.var_vehicle) * rng.standard_normal(width) if deviation is None else deviation
    x = model.mean + own
    x = x + (np.sqrt(model.var_flight) * rng.standard_normal((flights, width)) if scatter is None else scatter)
    x = x if change is None else x + change
    derivatives = 3.0 * rng.standard_normal((flights, rows, width)) @ (np.eye(width) if mixing is None else mixing)
    measured = (derivatives @ x[:, :, None])[:, :, 0] + rng.standard_normal((flights, rows))
    return VehicleFlights(
        vehicle=vehicle, product=derivatives.swapaxes(1, 2) @ derivatives,
        gradient=(derivatives.swapaxes(1, 2) @ measured[:, :, None])[:, :, 0],
        time=1000.0 + 60.0 * np.arange(flights), firmware=("1.0",) * flights,
    )  # fmt: skip


def make_fleet(
    rng: np.random.Generator, model: FleetModel, vehicles: int, flights: int, **options: Any
) -> list[VehicleFlights]:
    """Return the flights of vehicles ``v0``, ``v1``, ..."""
    return [make_flights(rng, model, flights, vehicle=f"v{k}", **options) for k in range(vehicles)]


def step(flights: int, onset: int, size: Any) -> Array:
    """Return a step of the columns since a flight, (N, K)."""
    return (np.arange(flights) >= onset)[:, None] * np.asarray(size, dtype=float)


def drift(flights: int, onset: int, size: Any) -> Array:
    """Return a drift that reaches a size in the last flight, (N, K)."""
    shares = np.maximum(np.arange(flights) - onset + 1.0, 0.0) / (flights - onset)
    return shares[:, None] * np.asarray(size, dtype=float)
