"""Sums over blocks of time: all that fits without a flight, scores and standard errors need of the residuals.

Letters: B blocks, C channels, K parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array, Indices

BLOCK_S = 2.0
"""Length of a block [s]: several times longer than residuals remember."""

SHORTEST_BLOCK_S = 0.5
"""Of flights that are too short for many blocks [s]: five periods of the usual band."""

ENOUGH_BLOCKS = 24
"""So many tell a scatter to 15 %."""

QUARTERS = 4
"""A single flight is left out in so many parts."""


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Sums over blocks of time; residual r, its derivative J in the parameters of the prediction."""

    count: Array
    """Rows, (B,)."""

    square: Array
    """``sum r²``, (B, C)."""

    gradient: Array
    """``sum J r``, (B, C, K)."""

    product: Array
    """``sum J J^T``, (B, C, K, K)."""

    flight: Indices
    """Which flight a block is from, (B,)."""

    def squares_after(self, step: Array) -> Array:
        """Return ``sum (r - J d)²`` of each block, (B, C), for a step d of the parameters, one per block, (B, K)."""
        linear = np.einsum("bck,bk->bc", self.gradient, step)
        change = np.einsum("bckl,bl->bck", self.product, step)
        return self.square - 2.0 * linear + np.einsum("bck,bk->bc", change, step)

    def joined(self, label: Indices) -> "Moments":
        """Return the sums over all blocks of one label, in the order of the labels; ``label`` is (B,)."""
        labels, first, place = np.unique(label, return_index=True, return_inverse=True)

        def joined(values: Array) -> Array:
            return np.stack([values[place == k].sum(axis=0) for k in range(labels.size)])

        return Moments(
            count=joined(self.count),
            square=joined(self.square),
            gradient=joined(self.gradient),
            product=joined(self.product),
            flight=self.flight[first],
        )


def block_length(times: Sequence[Array]) -> float:
    """Return how long blocks of flights with rows at these times [s] are [s]: shorter if there would be few."""
    total = sum(float(time[-1] - time[0]) for time in times)
    return float(np.clip(total / ENOUGH_BLOCKS, SHORTEST_BLOCK_S, BLOCK_S))


def folds(flight: Indices) -> Indices:
    """Return what is left out together: the flight of each block, or the quarter of a single flight, (B,)."""
    if flight.max() > 0:
        return flight
    parts = min(QUARTERS, flight.size)
    return np.arange(flight.size) * parts // flight.size


def block_rows(time: Array, length: float) -> list[Indices]:
    """Return the rows of each block of about a ``length`` [s] of a flight whose rows are at these times [s]."""
    blocks = max(1, round(float(time[-1] - time[0]) / length))
    return np.array_split(np.arange(time.size), blocks)


def time_groups(times: Sequence[Array]) -> Indices:
    """Return a number per row that is the same within a block of a flight, all flights in a row."""
    parts, start, length = [], 0, block_length(times)
    for time in times:
        part = ((time - time[0]) / length).astype(int) + start
        parts.append(part)
        start = int(part[-1]) + 1
    return np.concatenate(parts)


def flight_of_rows(times: Sequence[Array]) -> Indices:
    """Return the flight of each row, all flights in a row."""
    return np.repeat(np.arange(len(times)), [time.size for time in times])


def block_moments(
    times: Sequence[Array],
    residuals: Sequence[Array],
    jacobians: Sequence[Array],
    *,
    length: float | None = None,
) -> Moments:
    """Return the sums over blocks of about a ``length`` [s], none of which spans two flights.

    Args:
        times: Of each flight [s], (rows,).
        residuals: Of each flight, (rows, C).
        jacobians: Of each flight, (rows, C, K).
        length: Of a block; infinite: whole flights; None: what suits the flights (``block_length``).
    """
    length = block_length(times) if length is None else length
    blocks = [(flight, rows) for flight, time in enumerate(times) for rows in block_rows(time, length)]
    num_channels, width = residuals[0].shape[1], jacobians[0].shape[2]
    found = Moments(
        count=np.array([float(rows.size) for _, rows in blocks]),
        square=np.empty((len(blocks), num_channels)),
        gradient=np.empty((len(blocks), num_channels, width)),
        product=np.empty((len(blocks), num_channels, width, width)),
        flight=np.array([flight for flight, _ in blocks]),
    )
    for block, (flight, rows) in enumerate(blocks):
        r, j = residuals[flight][rows], jacobians[flight][rows].transpose(1, 2, 0)  # (C, K, rows)
        found.square[block] = (r**2).sum(axis=0)
        found.gradient[block] = (j @ r.T[:, :, None])[:, :, 0]
        np.matmul(j, j.transpose(0, 2, 1), out=found.product[block])
    return found


def of_flights(found: Sequence[Moments]) -> Moments:
    """Return the sums of all flights from those of each, one flight after the other."""
    return Moments(
        count=np.concatenate([one.count for one in found]),
        square=np.concatenate([one.square for one in found]),
        gradient=np.concatenate([one.gradient for one in found]),
        product=np.concatenate([one.product for one in found]),
        flight=np.repeat(np.arange(len(found)), [one.count.size for one in found]),
    )


@dataclass(frozen=True, kw_only=True)
class Weighting:
    """What a channel counts in a fit."""

    variance: Array
    """Mean square of the residual with every effect fitted, (C,)."""

    effective: Array
    """Independent samples per row: neighbours of a low-passed or coloured residual say the same, (C,)."""

    @property
    def weight(self) -> Array:
        """Return the weight of one row, (C,)."""
        return self.effective / self.variance

    def where_left(self, mean_square: Array) -> Array:
        """Return the weight of one row of other flights, of which more may be left, (C,): no more than that allows.

        Args:
            mean_square: Of what is left of each channel, (C,).
        """
        return self.effective / np.maximum(self.variance, mean_square)


def weights_from(residuals: Sequence[Array]) -> Weighting:
    """Return the weights that fit residuals, each (rows, C)."""
    rows = np.array([r.shape[0] for r in residuals], dtype=float)
    shares = np.stack([effective_share(r) for r in residuals])
    total = np.sum([(r**2).sum(axis=0) for r in residuals], axis=0)
    return Weighting(
        variance=np.maximum(total / rows.sum(), 1e-12),
        effective=(rows[:, None] * shares).sum(axis=0) / rows.sum(),
    )


def effective_share(residual: Array) -> Array:
    """Return the independent samples per row of each channel, (C,): one over twice the summed autocorrelation.

    The sum ends where pairs of neighbouring lags turn negative. Source: Geyer (1992), Practical Markov chain Monte Carlo,
    section 3.3, initial positive sequence.
    """
    rows = residual.shape[0]
    centred = residual - residual.mean(axis=0)
    spectrum = np.fft.rfft(centred, n=2 * rows, axis=0)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[: rows // 2]
    correlation = covariance / np.maximum(covariance[0], 1e-300)
    pairs = correlation[0 : len(correlation) // 2 * 2 : 2] + correlation[1::2][: len(correlation) // 2]
    positive = np.cumprod(pairs > 0.0, axis=0)
    return 1.0 / np.maximum(2.0 * (pairs * positive).sum(axis=0) - 1.0, 1.0)
