"""Distribution of the columns over a fleet, and the parameters of one vehicle under it."""

from dataclasses import dataclass

import numpy as np

from aerial_gym.fleet.statistics.moments import Columns, VehicleFlights
from aerial_gym.fleet.statistics.scan import ChangeScan
from aerial_gym.sim2real.arrays import Array


@dataclass(frozen=True, kw_only=True)
class FleetModel:
    """Distribution of the columns over vehicles and flights, in units of scale, (K,) each."""

    mean: Array
    var_vehicle: Array
    var_flight: Array
    mean_var: Array  # Posterior variance of the mean


@dataclass(frozen=True, kw_only=True)
class VehiclePosterior:
    """Parameters of one vehicle in physical units, one entry for each column, (K,)."""

    mean: Array
    std: Array


def vehicle_posterior(model: FleetModel, flights: VehicleFlights, columns: Columns) -> VehiclePosterior:
    """Return mean and standard deviation of a vehicle's parameters, given its flights and the fleet."""
    root = np.sqrt(model.var_vehicle)
    scan = ChangeScan.from_flights(flights.product, flights.gradient, model.mean, model.var_flight, root)
    scale = np.array([column.scale for column in columns])
    neutral = np.array([column.neutral for column in columns])
    variance = scan.base_cov(np.arange(root.size)).diagonal()
    return VehiclePosterior(mean=neutral + scale * (model.mean + scan.base()), std=scale * np.sqrt(variance))
