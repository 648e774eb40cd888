"""Mean, variance between vehicles and variance between flights of each column, estimated over a fleet.

Changed vehicles and odd flights must not hide themselves in the variances. A first fit therefore compares neighbouring
flights alone. It shows the strongest changes, which are then subtracted for a fit to whole vehicles. The deviations of a
flight follow Student's t distribution, so that one flight has a bounded influence.
Sources: Zhou, Hu, Qiao, Cho, Zhou (2019), MM algorithms for variance components models, J. Comput. Graph. Stat. 28 (updates
whose likelihood never falls); Lange, Little, Taylor (1989), Robust statistical modeling using the t distribution, JASA 84.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from hashlib import blake2b

import numpy as np

from aerial_gym.fleet.statistics.change import find_change, subtract_change
from aerial_gym.fleet.statistics.discovery import benjamini_hochberg
from aerial_gym.fleet.statistics.model import FleetModel
from aerial_gym.fleet.statistics.moments import Columns, VehicleFlights, integrate_flights, solve_lower, whitening
from aerial_gym.sim2real.arrays import Array

MOST_VEHICLES = 64  # Vehicles of a fit; the relative standard error of a variance is then at most 18 %
MOST_FLIGHTS = 20  # Flights of each vehicle in a fit
VEHICLE_STD, FLIGHT_STD = 1.0, 0.1
"""Prior standard deviations in units of scale. They count like one observed vehicle and like one flight."""
FREEDOM = 4.0  # Degrees of freedom of the deviations of flights
ITERATIONS, CONVERGENCE = 60, 0.03  # Most updates, and the relative change of all variances that ends them
DISCOVERY = 0.01  # Rate of false discoveries among the changes that are subtracted


def draw_vehicles(names: Iterable[str]) -> list[str]:
    """Return the vehicles of a fit, at most ``MOST_VEHICLES``: those with the least hash of their name."""
    return sorted(set(names), key=lambda name: blake2b(name.encode()).digest())[:MOST_VEHICLES]


def fit_fleet(vehicles: Sequence[VehicleFlights], columns: Columns) -> FleetModel:
    """Return the model of a fleet from at most ``MOST_VEHICLES`` of its vehicles (``draw_vehicles``)."""
    by_name = {one.vehicle: one for one in vehicles if one.firmware}
    drawn = [_thin_flights(by_name[name]) for name in draw_vehicles(by_name)]
    prior = prior_model(len(columns))
    pairs = [one.select(part) for one in drawn for part in _neighbours(len(one.firmware))]
    first = replace(prior, var_flight=_fit(pairs, prior).var_flight)
    results = [find_change(first, one, columns) for one in drawn]
    changed = benjamini_hochberg(np.array([one.log_e for one in results]), DISCOVERY)
    steady = [
        subtract_change(one, result.causes[0], columns) if is_changed else one
        for one, result, is_changed in zip(drawn, results, changed, strict=True)
    ]
    return _fit(steady, first)


def prior_model(columns: int) -> FleetModel:
    """Return the model of a fleet without flights."""
    one = np.ones(columns)
    return FleetModel(mean=0.0 * one, var_vehicle=VEHICLE_STD**2 * one, var_flight=FLIGHT_STD**2 * one, mean_var=one)


def _thin_flights(flights: VehicleFlights) -> VehicleFlights:
    """Return at most ``MOST_FLIGHTS`` flights of a vehicle, equally spaced."""
    count = len(flights.firmware)
    return flights.select(np.unique(np.linspace(0, count - 1, min(count, MOST_FLIGHTS)).round().astype(int)).tolist())


def _neighbours(count: int) -> list[list[int]]:
    """Return the indices of neighbouring flights in twos, the last three together if their number is odd."""
    pairs = [[k, k + 1] for k in range(0, count - 1, 2)] or [[0]]
    return [*pairs[:-1], [*pairs[-1], count - 1]] if count % 2 and count > 1 else pairs


def _fit(vehicles: Sequence[VehicleFlights], start: FleetModel) -> FleetModel:
    """Return the model with the largest posterior probability, by updates from a start."""
    if not vehicles:
        return start
    shown = np.flatnonzero(sum(np.einsum("nkk->k", one.product) for one in vehicles))
    flights = [(one.product[:, shown[:, None], shown], one.gradient[:, shown]) for one in vehicles]
    update = _Update(start.mean[shown], start.var_vehicle[shown], start.var_flight[shown], [len(b) for _, b in flights])
    for _ in range(ITERATIONS):
        if update.improve(flights) < CONVERGENCE:
            break
    fitted = {name: getattr(start, name).copy() for name in ("mean", "var_vehicle", "var_flight", "mean_var")}
    for name, values in fitted.items():
        values[shown] = getattr(update, name)
    return FleetModel(**fitted)


class _Update:
    """Updates of mean and variances of the shown columns, and of the weights of the flights.

    With moments A', b' about the mean, in which w_i is integrated out, and the posterior u of a vehicle, the scores are
    ``g_i = b_i' - A_i' u`` with expected squares ``d_i = diag(A_i' - A_i' cov(u) A_i')``. The variance of flights is
    multiplied by ``sqrt(sum g_i² / sum d_i)``; that of vehicles likewise by the sums over each vehicle's flights.
    """

    def __init__(self, mean: Array, var_vehicle: Array, var_flight: Array, counts: list[int]) -> None:
        self.mean, self.var_vehicle, self.var_flight = mean, var_vehicle, var_flight
        self.mean_var = np.ones(mean.size)
        self.weights = [np.ones(count) for count in counts]  # Precision of each flight's deviations, relative

    def improve(self, flights: Sequence[tuple[Array, Array]]) -> float:
        """Update all values; return the largest relative change of a variance."""
        width = self.mean.size
        precision, gradient = np.eye(width), -self.mean  # prior N(0, 1) of the mean
        vehicle, flight = np.zeros((2, width)), np.zeros((2, width))  # sums of squared scores, and their expectation
        for number, (product, right) in enumerate(flights):
            weight = self.weights[number][:, None]
            own = self.var_flight / weight
            product, right = integrate_flights(product, right - product @ self.mean, own)
            total, root = product.sum(axis=0), np.sqrt(self.var_vehicle)
            half = solve_lower(whitening(total, root), np.diag(root))  # cov(u) = half' half
            scores = right - product @ (half.T @ (half @ right.sum(axis=0)))
            expected = np.einsum("nkk->nk", product) - np.square(half @ product).sum(axis=1)
            part = half @ total
            remaining = total - part.T @ part
            precision += remaining
            gradient += scores.sum(axis=0)
            vehicle += np.square(scores.sum(axis=0)), remaining.diagonal()
            flight += (np.square(scores) / weight).sum(axis=0), (expected / weight).sum(axis=0)
            squares = (width + (own * (np.square(scores) - expected)).sum(axis=1)) / self.weights[number]
            self.weights[number] = (FREEDOM + width) / (FREEDOM + squares)
        cov = np.linalg.inv(precision)
        self.mean, self.mean_var = self.mean + cov @ gradient, cov.diagonal()
        factors = (_factor(self.var_vehicle, *vehicle, VEHICLE_STD), _factor(self.var_flight, *flight, FLIGHT_STD))
        self.var_vehicle, self.var_flight = self.var_vehicle * factors[0], self.var_flight * factors[1]
        return float(np.abs(np.log(factors)).max(initial=0.0))


def _factor(variance: Array, squares: Array, expected: Array, prior_std: float) -> Array:
    """Return the factor of a variance's update, with one prior observation of deviation ``prior_std``."""
    return np.sqrt((squares + np.square(prior_std / variance)) / (np.maximum(expected, 0.0) + 1.0 / variance))
