"""Root mean squares and their ratios with 95 % intervals, from the scatter of groups of neighbouring samples.

Letters: S samples, G groups, C columns.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RESAMPLES = 2000


@dataclass(frozen=True, kw_only=True)
class Rms:
    """A root mean square."""

    value: float
    low: float
    """End of the 95 % interval."""

    high: float
    """Other end."""

    def as_mapping(self) -> dict[str, float | list[float]]:
        """Return it for JSON."""
        return {"rms": self.value, "interval": [self.low, self.high]}


def rms_with_interval(values: Array, group: NDArray[np.int64], *, seed: int) -> list[Rms]:
    """Return the rms of each column, (S, C), with its interval from a bootstrap over whole groups.

    Neighbours are not independent, so that groups are drawn, not samples. Source: Davison, Hinkley (1997), Bootstrap
    Methods and their Application, section 3.8 and 5.3 (percentiles on the scale of the logarithm).
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


@dataclass(frozen=True, kw_only=True)
class Rise:
    """By which share one root mean square is above another one."""

    value: float
    low: float
    """End of the 95 % interval."""

    high: float
    """Other end."""

    def as_mapping(self) -> dict[str, float | list[float]]:
        """Return it for JSON."""
        return {"rises": self.value, "interval": [self.low, self.high]}


def rise_with_interval(values: Array, reference: Array, group: NDArray[np.int64], *, seed: int) -> list[Rise]:
    """Return ``rms(values) / rms(reference) - 1`` of each column, both (S, C), from a bootstrap over whole groups.

    Both are of the same samples and drawn together: what makes a sample hard for both does not widen the interval.
    """
    labels, place = np.unique(group, return_inverse=True)
    squares = np.zeros((2, labels.size, values.shape[1]))
    for sums, part in zip(squares, (values, reference), strict=True):
        np.add.at(sums, place, np.square(part))
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(labels.size, np.full(labels.size, 1.0 / labels.size), size=RESAMPLES).astype(float)
    above, below = draws @ squares[0], np.maximum(draws @ squares[1], 1e-300)
    low, high = np.quantile(np.sqrt(above / below), (0.025, 0.975), axis=0) - 1.0
    value = np.sqrt(squares[0].sum(axis=0) / np.maximum(squares[1].sum(axis=0), 1e-300)) - 1.0
    return [Rise(value=float(v), low=float(lo), high=float(hi)) for v, lo, hi in zip(value, low, high, strict=True)]
