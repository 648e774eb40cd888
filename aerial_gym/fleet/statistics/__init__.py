"""Statistics over a fleet: typical values and their scatter, changed vehicles, firmware versions, and times of limits.

Flights enter by their moments alone (``flight_evidence``), which are sums. Only NumPy and SciPy are needed.
Model: flight i of a vehicle has ``x_i = mean + u + w_i + change``, with ``u ~ N(0, var_vehicle)``, ``w_i ~ N(0, var_flight)``.
Letters: N flights of a vehicle, K columns, H hypotheses of a change, J onsets, P parameters of one effect.
"""

from aerial_gym.fleet.statistics.campaigns import campaign_evidence, exclude_campaigns
from aerial_gym.fleet.statistics.change import Change, ChangeResult, find_change
from aerial_gym.fleet.statistics.cohorts import CohortDifference, compare_cohorts
from aerial_gym.fleet.statistics.discovery import benjamini_hochberg
from aerial_gym.fleet.statistics.fit import FleetModel, VehiclePosterior, draw_vehicles, fit_fleet, vehicle_posterior
from aerial_gym.fleet.statistics.limits import time_to_limit
from aerial_gym.fleet.statistics.moments import VehicleFlights

__all__ = [
    "Change",
    "ChangeResult",
    "CohortDifference",
    "FleetModel",
    "VehicleFlights",
    "VehiclePosterior",
    "benjamini_hochberg",
    "campaign_evidence",
    "compare_cohorts",
    "draw_vehicles",
    "exclude_campaigns",
    "find_change",
    "fit_fleet",
    "time_to_limit",
    "vehicle_posterior",
]
