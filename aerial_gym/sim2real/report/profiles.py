"""Profiles of the residual: its mean over bins of thrust, speed, height and battery voltage, under each model.

Letters: T rows of a flight, S rows of all flights, C channels, B bins.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from aerial_gym.physics import Vehicle, vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.least_squares.moments import time_block_of_rows
from aerial_gym.sim2real.logs.flights import Flight, values_in_all_mappings
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times
from aerial_gym.sim2real.statistics import BinMeans, bin_means

BINS = 12  # Number of bins of equal count
LABELS = {"declared": "before", "corrected": "after"}  # Column names of the models
FEWEST_ROWS = 5  # Least number of rows in a plotted bin


@dataclass(frozen=True, kw_only=True)
class ResidualProfile:
    """The mean residual of every channel over bins of one quantity."""

    against: str  # Quantity and unit
    edges: Array  # Bin edges, (B + 1,)
    middle: Array  # Mean of the quantity in each bin, (B,)
    residual: dict[str, BinMeans]  # Mean residuals by model


def profile_quantities(flight: Flight, time: Array, vehicle: Vehicle, bandwidth: float) -> dict[str, Array]:
    """Return the quantities for profiles at times [s] (T,), as far as the log has them, (T,) each.

    Thrust is the declared total at measured speeds, or at the commands if speeds were not measured.
    """
    rows = rows_at_times(flight, time)
    assert flight.rotor_states is not None
    slow = torch.from_numpy(lowpass(flight.rotor_states, flight.rate, bandwidth)[rows])
    by_name = {"thrust [N]": rotor_thrust(vehicle, slow).sum(dim=1).numpy()}
    if flight.lin_vel is not None:
        by_name["speed [m/s]"] = np.linalg.norm(flight.lin_vel[rows], axis=1)
    if flight.position is not None:
        by_name["height [m]"] = flight.position[rows, 2] - flight.ground_height
    if flight.battery is not None:
        by_name["battery voltage [V]"] = flight.battery[rows]
    return by_name


def bin_edges(values: Array) -> Array:
    """Return edges of bins with equal counts, (B + 1,); fewer for repeated values."""
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))


def bin_index(edges: Array, values: Array) -> Indices:
    """Return the bin index of each value; the last bin includes its upper edge."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)


def mean_residual_profiles(predictor: Predictor, models: Mapping[str, ModelParams]) -> list[ResidualProfile]:
    """Return the profiles over all quantities that vary, for each model."""
    group, by_name = time_block_of_rows(predictor.times), []
    vehicle = vehicle_from_config(predictor.robot, num_envs=1, dtype=torch.float64)
    pairs = zip(predictor.flights, predictor.times, strict=True)
    own = values_in_all_mappings(
        [profile_quantities(flight, time, vehicle, predictor.bandwidth) for flight, time in pairs]
    )
    residuals = {name: np.concatenate(predictor.residuals(params)) for name, params in models.items()}
    for name, parts in own.items():
        values = np.concatenate(parts)
        edges = bin_edges(values)
        if edges.size < 3:
            continue
        place = bin_index(edges, values)
        bins = edges.size - 1
        middle = bin_means(values[:, None], place, bins, group).mean[:, 0]
        means = {model: bin_means(rows, place, bins, group) for model, rows in residuals.items()}
        by_name.append(ResidualProfile(against=name, edges=edges, middle=middle, residual=means))
    return by_name


def write_profiles(path: Path, profiles_list: list[ResidualProfile], channels: tuple[Channel, ...]) -> None:
    """Write every bin of every channel: edges, rows, and the mean residual of each model with its standard error."""
    tables = [pd.DataFrame(columns=["channel", "against", "low", "high", "middle", "rows", "blocks"])]
    for profile in profiles_list:
        first = next(iter(profile.residual.values()))
        for place, channel in enumerate(channels):
            columns: dict[str, object] = {
                "channel": channel.name,
                "against": profile.against,
                "low": profile.edges[:-1],
                "high": profile.edges[1:],
                "middle": profile.middle,
                "rows": first.count,
                "blocks": first.groups,
            }
            for model, means in profile.residual.items():
                name = LABELS[model]
                columns |= {name: means.mean[:, place], f"{name}_std_error": means.std_error[:, place]}
            tables.append(pd.DataFrame(columns))
    pd.concat(tables[1:] or tables).to_csv(path, index=False, float_format="%.6g", errors="surrogateescape")
