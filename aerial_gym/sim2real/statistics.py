"""Means, root mean squares and their ratios, with intervals from the scatter of groups of samples and of flights.

Distributions come from ``scipy.special``, since the import of ``scipy.stats`` takes longer than reading a flight.
Letters: S samples, G groups, B bins, C columns, P parameters.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from aerial_gym.sim2real.arrays import Array, Indices

RESAMPLES = 2000

FALSE_ALARM_HOURS = 100.0  # Mean flight time between two false alarms of a detector [h], under its noise model


def normal_tail(value: float) -> float:
    """Return the probability that a standard normal variable exceeds a value."""
    return float(special.ndtr(-value))


def normal_quantile(share: float) -> float:
    """Return the quantile of the standard normal distribution."""
    return float(special.ndtri(share))


def student_tail(value: float, freedom: float) -> float:
    """Return the probability that a variable with Student's t distribution exceeds a value."""
    return float(special.stdtr(freedom, -value))


def student_quantile(share: float, freedom: ArrayLike) -> Array:
    """Return quantiles of Student's t distribution, in the shape of ``freedom``."""
    return special.stdtrit(freedom, share)


def chi_square_tail(value: float, freedom: float) -> float:
    """Return the probability that a chi-squared variable exceeds a value."""
    return float(special.chdtrc(freedom, np.maximum(value, 0.0)))


def ratio_quantile(share: float, over: ArrayLike, under: ArrayLike) -> Array:
    """Return quantiles of Fisher's F distribution, with the degrees of freedom of numerator and denominator."""
    return special.fdtri(over, under, share)


def fit_line(x: Array, y: Array) -> tuple[float, float, float]:
    """Return slope and intercept of the least-squares line through points (S,), and the slope's p-value."""
    x_away, y_away, freedom = x - x.mean(), y - y.mean(), max(x.size - 2, 1)
    slope = float(x_away @ y_away) / float(x_away @ x_away)
    std_error = np.linalg.norm(y_away - slope * x_away) / np.sqrt(freedom * (x_away @ x_away))
    p_value = 2.0 * student_tail(abs(slope) / max(float(std_error), 1e-300), freedom)
    return slope, float(y.mean()) - slope * float(x.mean()), p_value


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A value with its 95 % interval."""

    label: ClassVar[str] = "value"  # Key of the value in JSON

    value: float
    low: float
    high: float  # Infinite without enough groups

    @classmethod
    def from_half_width(cls, value: float, half_width: float) -> Self:
        """Return a value with a symmetric interval."""
        return cls(value=float(value), low=float(value - half_width), high=float(value + half_width))

    def as_mapping(self) -> dict[str, float | list[float | None]]:
        """Return the values for JSON."""
        return {self.label: self.value, "interval": [self.low, self.high if np.isfinite(self.high) else None]}


class Rms(Estimate):
    """A root mean square with its interval."""

    label = "rms"


@dataclass(frozen=True, kw_only=True)
class Rise(Estimate):
    """Relative rise of one root mean square over another, with its interval over flights."""

    label = "rises"

    flights: tuple[tuple[float, float], ...] = ()  # Interval of each flight alone

    def reaches(self, limit: float, *, least: float) -> bool:
        """Return whether the whole interval reaches ``limit``, or the value does while the flights agree on a rise.

        A flight counts if it may change by ``least``. Flights agree if two or more rise for certain, or the only one that
        counts, and none falls for certain: an effect that acts in some flights alone scatters between flights, although no
        flight contradicts it.
        """
        return self.low >= limit or (self.value >= limit and self._do_flights_agree(1.0, least))

    def falls(self, *, least: float) -> bool:
        """Return whether the whole interval is below zero, or the value is while the flights agree on a fall."""
        return self.high < 0.0 or (self.value < 0.0 and self._do_flights_agree(-1.0, least))

    def _do_flights_agree(self, sign: float, least: float) -> bool:
        ends = [sorted((sign * low, sign * high)) for low, high in self.flights]
        changed = [(low, high) for low, high in ends if low <= -least or high >= least]
        rising = sum(low > 0.0 for low, _ in changed)
        return all(high >= 0.0 for _, high in changed) and (rising > 1 or rising == len(changed) == 1)


def rms_with_interval(values: Array, group: Indices, *, seed: int) -> list[Rms]:
    """Return the RMS of each column of (S, C), with its interval from a bootstrap over whole groups.

    Neighbouring samples are dependent, so groups are resampled. Source: Davison, Hinkley (1997), Bootstrap Methods and their
    Application, sections 3.8 and 5.3 (percentiles on the log scale).
    """
    labels, place = np.unique(group, return_inverse=True)
    squares = np.zeros((labels.size, values.shape[1]))
    np.add.at(squares, place, np.square(values))
    counts = np.bincount(place, minlength=labels.size).astype(float)
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(labels.size, np.full(labels.size, 1.0 / labels.size), size=RESAMPLES).astype(float)
    means = (draws @ squares) / np.maximum(draws @ counts, 1.0)[:, None]
    low, high = np.quantile(np.sqrt(means), (0.025, 0.975), axis=0)
    value = np.sqrt(squares.sum(axis=0) / counts.sum())
    return [Rms(value=float(v), low=float(lo), high=float(hi)) for v, lo, hi in zip(value, low, high, strict=True)]


def rise_with_interval(values: Array, reference: Array, group: Indices, flight: Indices) -> list[Rise]:
    """Return ``rms(values) / rms(reference) - 1`` of each column, both (S, C), with its interval over flights.

    Both share their samples, so common difficulty does not widen the interval. With squares ``a_g``, ``b_g`` of a group and
    their sums A, B, ``L = log(A / B) / 2`` has the scatter of the scores ``(a_g / A - b_g / B) / 2``.

    Args:
        group: Group of dependent samples, (S,).
        flight: Flight of each sample, (S,).

    Source:
        Davison, Hinkley (1997), Bootstrap Methods and their Application, section 2.7 (nonparametric delta method).
    """
    parts = [flight == number for number in np.unique(flight)]
    intervals = []
    for own in (np.ones(flight.size, dtype=bool), *parts):
        change, half = _log_ratio_with_half_width(values[own], reference[own], group[own], flight[own])
        with np.errstate(over="ignore"):
            intervals.append(np.expm1([change, change - half, change + half]))
    whole, *alone = np.array(intervals).transpose(0, 2, 1).tolist()  # (C, 3) each
    return [
        Rise(value=value, low=low, high=high, flights=tuple((one[place][1], one[place][2]) for one in alone))
        for place, (value, low, high) in enumerate(whole)
    ]


def _log_ratio_with_half_width(values: Array, reference: Array, group: Indices, flight: Indices) -> tuple[Array, Array]:
    """Return ``log(rms(values) / rms(reference))`` of each column, (C,), and half its 95 % interval."""
    scores, totals = [], []
    for part in (values, reference):
        total = np.maximum(np.square(part).sum(axis=0), 1e-300)
        totals.append(total)
        scores.append(np.square(part) / total)
    change, score = 0.5 * np.log(totals[0] / totals[1]), 0.5 * (scores[0] - scores[1])
    return change, half_width_of_scatter(*_variance_of_sum(score, group), *_variance_of_sum(score, flight))


def sum_with_interval(score: Array, group: Indices, flight: Indices) -> tuple[float, float, float]:
    """Return the sum of scores (S,) and the ends of its 95 % interval from the scatter between groups, or between flights."""
    total, away = float(score.sum()), (score - score.mean())[:, None]
    half = float(half_width_of_scatter(*_variance_of_sum(away, group), *_variance_of_sum(away, flight))[0])
    return total, total - half, total + half


def _variance_of_sum(score: Array, label: Indices) -> tuple[Array, int]:
    """Return the variance of the sum of scores (S, C) between clusters, (C,), and their number; infinite for one cluster."""
    labels, place = np.unique(label, return_inverse=True)
    sums = np.zeros((labels.size, score.shape[1]))
    np.add.at(sums, place, score)
    if labels.size < 2:
        return np.full(score.shape[1], np.inf), labels.size
    return (sums**2).sum(axis=0) * labels.size / (labels.size - 1), labels.size


@dataclass(frozen=True, kw_only=True)
class BinMeans:
    """Means of samples by bin."""

    count: Indices  # Number of samples in each bin, (B,)
    mean: Array  # (B, C); NaN for an empty bin
    std_error: Array  # Standard error of the mean, (B, C); NaN with fewer than two groups in the bin
    groups: Indices  # Number of groups in each bin, (B,), which determines the certainty of the standard error

    @property
    def half_width(self) -> Array:
        """Return half the 68 % interval of each mean, (B, C): the standard error, widened for few groups."""
        freedom = np.maximum(self.groups - 1, 1)[:, None]
        return student_quantile(normal_tail(-1.0), freedom) * self.std_error


def bin_means(values: Array, place: Indices, bins: int, group: Indices) -> BinMeans:
    """Return the mean of each bin, and its standard error from the scatter of whole groups.

    Its square is ``sum_g (s_g - n_g m)² G / (G - 1) / n²``, with the sum ``s_g`` of the ``n_g`` samples that group g of G
    has in the bin.
    Source: Cochran (1977), Sampling Techniques, section 6.3 (a ratio of sums over clusters).

    Args:
        values: Samples, (S, C).
        place: Bin of each sample, (S,).
        group: Group of dependent samples, (S,).
    """
    labels, own = np.unique(group, return_inverse=True)
    cell = place * labels.size + own
    counts = np.bincount(cell, minlength=bins * labels.size).reshape(bins, labels.size)
    sums = np.zeros((bins * labels.size, values.shape[1]))
    np.add.at(sums, cell, values)
    sums, total, groups = sums.reshape(bins, labels.size, -1), counts.sum(axis=1), (counts > 0).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums.sum(axis=1) / total[:, None]
        away = np.where(counts[:, :, None] > 0, sums - counts[:, :, None] * mean[:, None], 0.0)
        variance = (away**2).sum(axis=1) / total[:, None] ** 2 * (groups / (groups - 1.0))[:, None]
    std_error = np.sqrt(np.where(groups[:, None] > 1, variance, np.nan))
    return BinMeans(count=total, mean=mean, std_error=std_error, groups=groups)


DOUBTFUL = 0.2  # Significance level at which flights count as scattering more than their blocks explain
FEWEST_FLIGHTS = 3  # Least number of flights for an estimate of their scatter


def half_width_of_scatter(blocks: Array, num_blocks: int, flights: Array | None, num_flights: int) -> Array:
    """Return half the 95 % interval, (P,), from the scatter of blocks, or of flights if it is significantly larger.

    Args:
        blocks: Variances from the scatter of time blocks, (P,).
        flights: Variances from the scatter of whole flights, (P,); None with too few.
    """
    count = max(num_blocks - 1, 1)
    variance = student_quantile(0.975, count) ** 2 * blocks
    if flights is not None and num_flights >= FEWEST_FLIGHTS:
        between = num_flights - 1
        limit = ratio_quantile(1.0 - DOUBTFUL, between, count)
        variance = np.where(flights > limit * blocks, student_quantile(0.975, between) ** 2 * flights, variance)
    return np.sqrt(variance)
