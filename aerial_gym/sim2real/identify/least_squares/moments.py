"""Sums over time blocks, sufficient for fits without a flight, scores and standard errors.

Letters: B blocks, C channels, K parameters.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array, Indices

BLOCK_S = 2.0  # Block length [s], several times the correlation time of residuals
SHORTEST_BLOCK_S = 0.5  # Block length of short flights [s]: five periods of the usual band
ENOUGH_BLOCKS = 24  # Number of blocks that determines a scatter to 15 %
SUMS = ("count", "square", "gradient", "product")  # Fields of ``Moments`` with sums


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Sums over time blocks of residual r and its derivative J by the prediction's parameters."""

    count: Array  # Number of rows, (B,)
    square: Array  # ``sum r²``, (B, C)
    gradient: Array  # ``sum J r``, (B, C, K)
    product: Array  # ``sum J J^T``, (B, C, K, K)
    flight: Indices  # Flight of each block, (B,)

    def block_squares(self, step: Array) -> Array:
        """Return ``sum (r - J d)²`` of each block, (B, C), for parameter steps d per block, (B, K)."""
        linear = np.einsum("bck,bk->bc", self.gradient, step)
        change = np.einsum("bckl,bl->bck", self.product, step)
        return self.square - 2.0 * linear + np.einsum("bck,bk->bc", change, step)

    def sum_by_label(self, label: Indices) -> "Moments":
        """Return the sums over blocks of equal label, in ascending order of labels; ``label`` is (B,)."""
        labels, first, place = np.unique(label, return_index=True, return_inverse=True)
        sums = {
            name: np.stack([getattr(self, name)[place == k].sum(axis=0) for k in range(labels.size)]) for name in SUMS
        }
        return Moments(**sums, flight=self.flight[first])


def block_length(times: Sequence[Array]) -> float:
    """Return the block length [s] for flights with these row times [s]; shorter for short flights."""
    total = sum(float(time[-1] - time[0]) for time in times)
    return float(np.clip(total / ENOUGH_BLOCKS, SHORTEST_BLOCK_S, BLOCK_S))


def time_block_of_rows(times: Sequence[Array]) -> Indices:
    """Return the block number of each row, unique over all flights in sequence."""
    parts, start, length = [], 0, block_length(times)
    for time in times:
        part = ((time - time[0]) / length).astype(int) + start
        parts.append(part)
        start = int(part[-1]) + 1
    return np.concatenate(parts)


def flight_of_rows(times: Sequence[Array]) -> Indices:
    """Return the flight index of each row, for all flights in sequence."""
    return np.repeat(np.arange(len(times)), [time.size for time in times])


def time_blocks(times: Sequence[Array], length: float) -> list[tuple[int, Indices]]:
    """Return the flight and the rows of each time block of about ``length`` [s]."""
    blocks = list[tuple[int, Indices]]()
    for flight, time in enumerate(times):
        count = max(1, round(float(time[-1] - time[0]) / length))
        blocks += [(flight, rows) for rows in np.array_split(np.arange(time.size), count)]
    return blocks


def block_moments(
    times: Sequence[Array], residuals: Iterable[Array], jacobians: Iterable[Array], *, length: float | None = None
) -> Moments:
    """Return the sums over blocks of ``length`` [s] (infinite: whole flights; None: ``block_length``) within flights.

    ``times`` [s], (rows,); ``residuals``, (rows, C); ``jacobians``, (rows, C, K), of each flight, used one after another.
    """
    blocks = time_blocks(times, block_length(times) if length is None else length)
    flight, moments, block = np.array([flight for flight, _ in blocks]), None, 0
    for place, (residual, jacobian) in enumerate(zip(residuals, jacobians, strict=True)):
        if moments is None:
            moments = _empty_moments(flight, np.array([float(rows.size) for _, rows in blocks]), *jacobian.shape[1:])
        for rows in (slice(rows[0], rows[-1] + 1) for own, rows in blocks if own == place):
            r = residual[rows]
            j = jacobian[rows].transpose(1, 2, 0)  # (C, K, rows); a copy would lose the order in memory
            moments.square[block] = (r**2).sum(axis=0)
            moments.gradient[block] = (j @ r.T[:, :, None])[:, :, 0]
            np.matmul(j, j.transpose(0, 2, 1), out=moments.product[block])
            block += 1
    assert moments is not None
    return moments


def _empty_moments(flight: Indices, count: Array, channels: int, width: int) -> Moments:
    """Return moments of blocks (B,) for so many channels and columns, to be written."""
    sums = (np.empty((count.size, channels, *(width,) * times)) for times in range(3))
    return Moments(**dict(zip(SUMS, (count, *sums), strict=True)), flight=flight)


def concatenate_moments(moments: Sequence[Moments]) -> Moments:
    """Return the sums of all flights, concatenated in order."""
    sums = {name: np.concatenate([getattr(one, name) for one in moments]) for name in SUMS}
    return Moments(**sums, flight=np.repeat(np.arange(len(moments)), [one.count.size for one in moments]))


@dataclass(frozen=True, kw_only=True)
class Weighting:
    """Weights of the channels in a fit."""

    variance: Array  # Mean squared residual with every effect fitted, (C,)
    effective: Array  # Independent samples per row, (C,); below 1 for low-passed or coloured residuals

    @property
    def weight(self) -> Array:
        """Return the weight of one row, (C,)."""
        return self.effective / self.variance

    def weight_below_limit(self, mean_square: Array) -> Array:
        """Return the weight of one row, (C,), limited by the mean square (C,) of other flights' residuals."""
        return self.effective / np.maximum(self.variance, mean_square)


def inverse_variance_weights(residuals: Sequence[Array]) -> Weighting:
    """Return the channel weights from residuals, each (rows, C)."""
    rows = np.array([r.shape[0] for r in residuals], dtype=float)
    shares = np.stack([share_of_independent_rows(r) for r in residuals])
    total = np.sum([(r**2).sum(axis=0) for r in residuals], axis=0)
    effective = (rows[:, None] * shares).sum(axis=0) / rows.sum()
    return Weighting(variance=np.maximum(total / rows.sum(), 1e-12), effective=effective)


def share_of_independent_rows(residual: Array) -> Array:
    """Return the independent samples per row of each channel, (C,): ``1 / (2 sum autocorrelation - 1)``.

    Source: Geyer (1992), Practical Markov chain Monte Carlo, section 3.3: the sum ends at the first negative sum of
    neighbours.
    """
    rows = residual.shape[0]
    centred = residual - residual.mean(axis=0)
    spectrum = np.fft.rfft(centred, n=2 * rows, axis=0)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[: rows // 2]
    correlation = covariance / np.maximum(covariance[0], 1e-300)
    pairs = correlation[0 : len(correlation) // 2 * 2 : 2] + correlation[1::2][: len(correlation) // 2]
    positive = np.cumprod(pairs > 0.0, axis=0)
    return 1.0 / np.maximum(2.0 * (pairs * positive).sum(axis=0) - 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class FlightOffsets:
    """Prior of the flight offsets, with the noise weights."""

    size: Array  # Standard deviation s in each channel, (C,); 0 without offsets
    weight: Array  # Weight w of one row, (C,)
    most: Array  # Upper limit of s, independent of the flights that estimated it, (C,)

    @property
    def has_offsets(self) -> bool:
        """Return whether any channel has offsets."""
        return bool(self.size.any())

    def remove_offsets(self, parts: Iterable[Array]) -> Iterable[Array]:
        """Return residuals (rows, C), or derivatives (rows, C, K), minus the share of their flight means, one by one."""
        if not self.has_offsets:
            return parts
        return (
            part - self.share_of_mean(len(part)).reshape(-1, *(1,) * (part.ndim - 2)) * part.mean(axis=0)
            for part in parts
        )

    def share_of_mean(self, rows: int) -> Array:
        """Return the subtracted share of the mean in each channel for so many rows, (C,)."""
        return 1.0 - 1.0 / np.sqrt(self._variance_ratio(rows))

    def log_likelihood(self, rows: Sequence[int]) -> float:
        """Return the log likelihood term of flights with these numbers of rows: ``-sum log(1 + n w s²) / 2``."""
        return -0.5 * float(sum(np.log(self._variance_ratio(count)).sum() for count in rows))

    def _variance_ratio(self, rows: int) -> Array:
        return 1.0 + rows * self.weight * self.size**2
