"""Whether two vehicles in the same flight feel the same random wind. Letters: T rows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.random_wind.ornstein_uhlenbeck import ProcessFit, WindSeries, log_likelihoods
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import interpolate_columns

CORRELATIONS = np.linspace(0.0, 1.0, 51)  # Equally probable before the flights
LONGEST_SHIFT = 10  # Rows by which two winds are shifted at most: 1 s
SURE = 0.95  # Least probability at which the wind counts as shared, or as separate


@dataclass(frozen=True, kw_only=True)
class CommonWind:
    """Correlation of the random wind at both vehicles of each pair, errors of each log included: these lower it."""

    correlation: float  # Mean of its posterior
    interval: tuple[float, float]  # Holds it with 95 %
    probability: float  # That it exceeds one half: most of the wind's variance is the same at both

    is_shifted: bool = False
    """Whether more than half of it is the same at another offset of the clocks: they differ, or the wind moves from one to
    the other."""

    @property
    def finding(self) -> Finding:
        """Return whether both vehicles feel the same wind."""
        low, high = self.interval
        values = {"correlation": self.correlation, "low": low, "high": high}
        if 1.0 - SURE < self.probability < SURE or (self.is_shifted and self.probability < SURE):
            return Finding("gusts_undecided", "gusts", values)
        return Finding("gusts_shared" if self.probability >= SURE else "gusts_separate", "gusts", values)


def correlation_of_winds(pairs: Sequence[tuple[Array, Array]], series: WindSeries, fit: ProcessFit) -> CommonWind:
    """Return the correlation of the wind at both vehicles, from their winds on a common clock, (T, 3) each.

    With a correlation r of two equal processes, sum and difference over sqrt(2) are independent, with variances times
    1 + r and 1 - r, and the noise of one.
    """
    total = np.zeros(CORRELATIONS.size)
    for sign in (1.0, -1.0):
        mixed = replace(series, wind=[(one + sign * other) / sqrt(2.0) for one, other in pairs])
        total += log_likelihoods(mixed, [fit.process(fit.std * sqrt(1.0 + sign * r)) for r in CORRELATIONS.tolist()])
    weight = np.exp(total - total.max())
    weight /= weight.sum()
    low, high = np.interp((0.025, 0.975), np.cumsum(weight) - 0.5 * weight, CORRELATIONS)
    above = float(weight[CORRELATIONS > 0.5].sum() + 0.5 * weight[CORRELATIONS == 0.5].sum())
    shifted = max(_correlation_at_shift(pairs, k) for k in range(-LONGEST_SHIFT, LONGEST_SHIFT + 1)) > 0.5
    interval = float(low), float(high)
    mean = float(weight @ CORRELATIONS)
    return CommonWind(correlation=mean, interval=interval, probability=above, is_shifted=shifted)


def _correlation_at_shift(pairs: Sequence[tuple[Array, Array]], rows: int) -> float:
    """Return the correlation of the winds of all pairs, without their means, with the second ones so many rows later."""
    products = np.zeros(3)
    for both in (pair for pair in pairs if len(pair[0]) > 2 * abs(rows)):
        one, other = (wind - wind.mean(axis=0) for wind in both)
        one, other = (one[rows:], other[: len(other) - rows]) if rows >= 0 else (one[:rows], other[-rows:])
        products += [(one * other).sum(), (one**2).sum(), (other**2).sum()]
    return float(products[0] / max(sqrt(products[1] * products[2]), 1e-12))


def winds_of_pairs(
    flights: Sequence[Flight], times: Sequence[Array], winds: Sequence[Array], step: float
) -> list[tuple[Array, Array]]:
    """Return the wind of both vehicles of each pair at common times ``step`` [s] apart, from that of each flight, (T, 3)."""
    members: dict[int, dict[int, tuple[Array, Array]]] = {}
    for flight, time, wind in zip(flights, times, winds, strict=True):
        if flight.pair is not None:
            members.setdefault(flight.pair.pair, {})[flight.pair.vehicle] = time + flight.pair.clock, wind
    results = []
    for both in (pair for pair in members.values() if len(pair) == 2):
        (one, wind), (other, other_wind) = both[0], both[1]
        common = np.arange(max(one[0], other[0]), min(one[-1], other[-1]), step)
        if common.size > 1:
            results.append((interpolate_columns(common, one, wind), interpolate_columns(common, other, other_wind)))
    return results
