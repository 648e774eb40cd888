"""Differences between firmware versions over a fleet.

Flights of firmware B have ``x_i = mean + u + w_i + d``. The vehicle's deviation u cancels in vehicles that flew both versions;
others add what the variance between vehicles leaves. The mean is fitted anew, with the prior of the model.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.fleet.statistics.change import AMBIGUOUS
from aerial_gym.fleet.statistics.discovery import benjamini_hochberg
from aerial_gym.fleet.statistics.fit import FleetModel
from aerial_gym.fleet.statistics.moments import Columns, VehicleFlights
from aerial_gym.fleet.statistics.scan import (
    SIZES,
    ChangeScan,
    Hypotheses,
    change_posterior,
    log_factors_by_size,
    log_sum,
    mixture_moments,
)
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.statistics import normal_quantile

FEWEST_VEHICLES = 3  # That flew the compared version, for equality to be rejected


@dataclass(frozen=True, kw_only=True)
class CohortDifference:
    """Difference of one effect between two firmware versions, in physical units."""

    firmware: tuple[str, str]  # Reference A and the compared version B
    effect: str
    rotor: int
    parameters: tuple[str, ...]
    difference: tuple[float, ...]  # B less A
    low: tuple[float, ...]  # Ends of its 95 % interval
    high: tuple[float, ...]
    log_e: float  # Log Bayes factor against no difference, without the vehicle that supports it most
    rejected: bool  # Whether equality is rejected over all effects and versions, by Benjamini-Hochberg
    leading: bool  # Whether no other effect explains the two versions better by 20 to 1
    flights: tuple[int, int]
    vehicles: tuple[int, int]
    vehicles_of_both: int


def compare_cohorts(
    model: FleetModel, vehicles: Sequence[VehicleFlights], columns: Columns, level: float = 0.01
) -> list[CohortDifference]:
    """Return the differences of each firmware version from the most flown one, strongest evidence first.

    No difference rests on one vehicle. Flights of unknown firmware are left out.
    """
    counts = Counter(name for one in vehicles for name in one.firmware if name)
    reference, *versions = sorted(counts, key=lambda name: (-counts[name], name)) or [""]
    rows = [row for version in versions for row in _differences(model, vehicles, columns, (reference, version))]
    rejected = benjamini_hochberg(np.array([row.log_e for row in rows]), level)
    rows = [replace(row, rejected=bool(is_rejected)) for row, is_rejected in zip(rows, rejected, strict=True)]
    return sorted(rows, key=lambda row: -row.log_e)


def _differences(
    model: FleetModel, vehicles: Sequence[VehicleFlights], columns: Columns, firmware: tuple[str, str]
) -> list[CohortDifference]:
    flown, parts = [], []
    for one in vehicles:
        chosen = one.select([k for k, name in enumerate(one.firmware) if name in firmware])
        is_second = np.array([name == firmware[1] for name in chosen.firmware])
        flown.append((int((~is_second).sum()), int(is_second.sum())))
        if is_second.size:
            scan = ChangeScan.from_flights(
                chosen.product, chosen.gradient, model.mean, model.var_flight, np.sqrt(model.var_vehicle)
            )
            parts.append(scan.cohort_moments(is_second))
    product, gradient = (np.sum(arrays, axis=0) for arrays in zip(*parts, strict=True))
    hypotheses = Hypotheses.from_columns(columns, product.diagonal()[model.mean.size :] > 0.0)
    estimates = _estimate(model, product, gradient, hypotheses)
    without = [_estimate(model, product - own, gradient - right, hypotheses) for own, right in parts]
    is_many = sum(second > 0 for _, second in flown) >= FEWEST_VEHICLES
    rows = []
    for k, (cause, places) in enumerate(zip(hypotheses.cause, hypotheses.columns, strict=True)):
        mean, cov, log_e = estimates[k]
        scale = np.array([columns[place].scale for place in places])
        half = normal_quantile(0.975) * np.sqrt(cov.diagonal()) * scale
        log_e = min(log_e, *(one[k][2] for one in without), *(() if is_many else (0.0,)))
        rows.append((hypotheses.causes[cause], places, mean * scale, half, log_e))
    best = max((row[-1] for row in rows), default=0.0)
    counts: Array = np.array(flown)
    return [
        CohortDifference(
            firmware=firmware, effect=effect, rotor=rotor, parameters=tuple(columns[k].parameter for k in places),
            difference=tuple(mean.tolist()), low=tuple((mean - half).tolist()), high=tuple((mean + half).tolist()),
            log_e=log_e, rejected=False, leading=log_e >= best - AMBIGUOUS,
            flights=tuple(counts.sum(axis=0).tolist()), vehicles=tuple((counts > 0).sum(axis=0).tolist()),
            vehicles_of_both=int((counts > 0).all(axis=1).sum()),
        )
        for (effect, rotor), places, mean, half, log_e in rows
    ]  # fmt: skip


def _estimate(
    model: FleetModel, product: Array, gradient: Array, hypotheses: Hypotheses
) -> list[tuple[Array, Array, float]]:
    """Return mean, covariance and log evidence of each hypothesis' difference, from the information about (mean, d)."""
    width, rows = model.mean.size, []
    first = slice(0, width)
    right = np.column_stack((product[first, width:], gradient[first] - model.mean))
    back = np.linalg.solve(product[first, first] + np.eye(width), right)
    for places in hypotheses.columns:
        own, cross = places + width, product[places + width, first]
        information = product[np.ix_(own, own)] - cross @ back[:, places]
        slope = gradient[own] - cross @ back[:, -1]
        log_e = float(log_sum(log_factors_by_size(information, slope)) - np.log(len(SIZES)))
        rows.append((*mixture_moments(*change_posterior(information, slope)), log_e))
    return rows
