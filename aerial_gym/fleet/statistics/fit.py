"""Mean, variance between vehicles and variance between flights of each column, estimated over a fleet.

Vehicles differ in the variance between their flights: it is ``factor var_flight`` with an inverse gamma prior of the factor, so
that the deviations follow Student's t distribution. A changed vehicle thus has a bounded influence on the fleet's variance.
Sources: Zhou, Hu, Qiao, Cho, Zhou (2019), MM algorithms for variance components models, J. Comput. Graph. Stat. 28 (updates
whose likelihood never falls); Lange, Little, Taylor (1989), Robust statistical modeling using the t distribution, JASA 84.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import TYPE_CHECKING

import numpy as np

from aerial_gym.fleet.statistics.moments import Columns, VehicleFlights, integrate_flights, solve_lower, whitening
from aerial_gym.fleet.statistics.scan import SIZES, ChangeScan
from aerial_gym.sim2real.arrays import Array, Flags

if TYPE_CHECKING:  # imports this module
    from aerial_gym.fleet.statistics.change import ChangeResult

MOST_VEHICLES = 64  # Vehicles of a fit; the relative standard error of a variance is then at most 18 %
MOST_FLIGHTS = 20  # Flights of each vehicle in a fit
VEHICLE_PRIOR, FLIGHT_PRIOR = (1.0, 0.1), (0.1, 1.0)
"""Prior standard deviations in units of scale, with the number of observed vehicles or flights for which they count."""
FREEDOM = 4.0  # Degrees of freedom of the variance between the flights of one vehicle
ITERATIONS, CONVERGENCE = 60, 1e-3  # Most updates, and the relative change of all standard deviations that ends them
PERIOD, MOST_RATIO = (
    3,
    0.9,
)  # Updates between extrapolations, and the largest ratio of successive steps that is extrapolated


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


def draw_vehicles(names: Iterable[str]) -> list[str]:
    """Return the vehicles of a fit, at most ``MOST_VEHICLES``: those with the least hash of their name."""
    return sorted(set(names), key=lambda name: blake2b(name.encode()).digest())[:MOST_VEHICLES]


def fit_fleet(vehicles: Sequence[VehicleFlights], columns: Columns) -> FleetModel:
    """Return the model of a fleet from at most ``MOST_VEHICLES`` of its vehicles (``draw_vehicles``)."""
    by_name = {one.vehicle: one for one in vehicles if one.firmware}
    drawn = [_thin_flights(by_name[name]) for name in draw_vehicles(by_name)]
    one = np.ones(len(columns))
    fitted = {
        "mean": 0.0 * one,
        "var_vehicle": VEHICLE_PRIOR[0] ** 2 * one,
        "var_flight": FLIGHT_PRIOR[0] ** 2 * one,
        "mean_var": one,
    }
    shown = np.flatnonzero(sum((np.einsum("nkk->k", part.product) for part in drawn), 0.0 * one))
    flights = [(part.product[:, shown[:, None], shown], part.gradient[:, shown]) for part in drawn]
    update = _Update(shown.size, len(drawn))
    for _ in range(ITERATIONS):
        if update.improve(flights) < CONVERGENCE:
            break
    for name, values in fitted.items():
        values[shown] = getattr(update, name)
    return FleetModel(**fitted)


def vehicle_posterior(
    model: FleetModel, flights: VehicleFlights, columns: Columns, result: "ChangeResult | None" = None
) -> VehiclePosterior:
    """Return mean and standard deviation of a vehicle's parameters at its last flight, given its flights and the fleet.

    Flights of another state count no more: odd ones, and those on the other side of a change that is evident.
    """
    named = dict[tuple[str, int, str], tuple[float, float]]()
    if result is not None:
        place = np.arange(len(flights.firmware))
        is_kept: Flags = ~np.isin(place, result.odd_flights)
        if result.is_evident:
            best, end = result.causes[0], result.end
            is_kept &= place >= best.onset_high if end is None else (place < best.onset_low) | (place >= end)
            if end is None and len(result.candidates) == 1:
                for name, *level in zip(best.parameters, best.level, best.level_std, strict=True):
                    named[best.effect, best.rotor, name] = (level[0], level[1])
        flights = flights.select(place[is_kept])
    root = np.sqrt(model.var_vehicle)
    scan = ChangeScan.from_flights(flights.product, flights.gradient, model.mean, model.var_flight, root)
    scale, neutral = (np.array([getattr(column, name) for column in columns]) for name in ("scale", "neutral"))
    std: Array = np.sqrt(scan.base_cov(np.arange(root.size)).diagonal())
    mean, std = neutral + scale * (model.mean + scan.base()), scale * std
    for k, column in enumerate(columns):
        mean[k], std[k] = named.get((column.effect, column.rotor, column.parameter), (mean[k], std[k]))
    return VehiclePosterior(mean=mean, std=std)


def _thin_flights(flights: VehicleFlights) -> VehicleFlights:
    """Return at most ``MOST_FLIGHTS`` flights of a vehicle, equally spaced."""
    count = len(flights.firmware)
    return flights.select(np.unique(np.linspace(0, count - 1, min(count, MOST_FLIGHTS)).round().astype(int)).tolist())


class _Update:
    """Updates of mean and variances of the shown columns, and of the weights of the flights.

    With moments A', b' about the mean, in which w_i is integrated out, and the posterior u of a vehicle, the scores are
    ``g_i = b_i' - A_i' u`` with expected squares ``d_i = diag(A_i' - A_i' cov(u) A_i')``. The variance of flights is
    multiplied by ``sqrt(sum g_i² / sum d_i)``; that of vehicles likewise by the sums over each vehicle's flights.
    Every third step is extrapolated to the limit of a geometric series of steps (Aitken).
    """

    def __init__(self, columns: int, vehicles: int) -> None:
        self.mean, self.mean_var = np.zeros(columns), np.ones(columns)
        self.var_vehicle, self.var_flight = (
            np.full(columns, VEHICLE_PRIOR[0] ** 2),
            np.full(columns, FLIGHT_PRIOR[0] ** 2),
        )
        self.weights = np.ones((vehicles, columns))  # Fleet's variance between flights per that of a vehicle
        self.updates, self.last_step = 0, np.zeros((2, columns))  # Logarithm of the last factors on the variances

    def improve(self, flights: Sequence[tuple[Array, Array]]) -> float:
        """Update all values; return the largest change of a standard deviation, relative to it and the least change sought."""
        width = self.mean.size
        precision, gradient = np.eye(width), -self.mean  # prior N(0, 1) of the mean
        vehicle, flight = np.zeros((2, width)), np.zeros((2, width))  # sums of squared scores, and their expectation
        for weight, (product, right) in zip(self.weights, flights, strict=True):
            product, right = integrate_flights(product, right - product @ self.mean, self.var_flight / weight)
            total, root = product.sum(axis=0), np.sqrt(self.var_vehicle)
            half = solve_lower(whitening(total, root), np.diag(root))  # cov(u) = half' half
            scores = right - product @ (half.T @ (half @ right.sum(axis=0)))
            expected = (np.einsum("nkk->nk", product) - np.square(half @ product).sum(axis=1)).sum(axis=0)
            squares, count = np.square(scores).sum(axis=0), len(right)
            part = half @ total
            remaining = total - part.T @ part
            precision += remaining
            gradient += scores.sum(axis=0)
            vehicle += np.square(scores.sum(axis=0)), remaining.diagonal()
            flight += squares / weight, expected / weight
            deviations = count / weight + self.var_flight / weight**2 * (squares - expected)
            weight[:] = (FREEDOM + count) / (FREEDOM + deviations)
        cov = np.linalg.inv(precision)
        self.mean, self.mean_var = self.mean + cov @ gradient, cov.diagonal()
        step = np.log(
            [_factor(self.var_vehicle, vehicle, VEHICLE_PRIOR), _factor(self.var_flight, flight, FLIGHT_PRIOR)]
        )
        variances, self.updates = np.stack((self.var_vehicle, self.var_flight)), self.updates + 1
        change = np.abs(np.expm1(0.5 * step) / (1.0 + SIZES[0] / np.sqrt(variances))).max(initial=0.0)
        ratio = np.divide(step, self.last_step, out=np.zeros_like(step), where=self.last_step != 0.0)
        limit = 1.0 - np.clip(ratio, 0.0, MOST_RATIO) if self.updates % PERIOD == 0 else 1.0
        self.var_vehicle, self.var_flight = variances * np.exp(step / limit)
        self.last_step = step
        return float(change)


def _factor(variance: Array, scores: Array, prior: tuple[float, float]) -> Array:
    """Return the factor of a variance's update, from sums of squared scores and their expectations, (2, K)."""
    (squares, expected), (std, count) = scores, prior
    return np.sqrt((squares + count * np.square(std / variance)) / (np.maximum(expected, 0.0) + count / variance))
