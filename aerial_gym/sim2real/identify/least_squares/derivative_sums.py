"""Derivatives times the square root of the channel weights, and their products over time blocks.

Columns are stored only for the channels that they affect: a structure or a sensor bias affects one. Letters: T rows of a
flight, c channels of C, P parameters of a part, K of all parts, B blocks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerial_gym.interop import map_in_threads
from aerial_gym.sim2real.arrays import Array, Indices, has_nonzero
from aerial_gym.sim2real.identify.least_squares.moments import FlightOffsets, Moments, concatenate_moments


@dataclass(frozen=True, kw_only=True)
class SparseDerivatives:
    """Derivatives of a flight by P parameters, stored sparsely: zero in other channels and parameters."""

    values: NDArray[np.floating]  # Derivatives by p consecutive parameters, (T, c, p)
    channels: tuple[int, ...]  # Indices of the c channels among all C
    width: int  # Number of parameters P
    first: int = 0  # Index of the first of the p parameters

    def dense_columns(self, channels: Sequence[int]) -> NDArray[np.floating]:
        """Return the dense columns of some channels, (T, channels, P)."""
        sums = np.zeros((self.width, len(channels), len(self.values)), dtype=self.values.dtype).T
        own = slice(self.first, self.first + self.values.shape[2])
        for place, channel in enumerate(channels):
            if channel in self.channels:
                sums[:, place, own] = self.values[:, self.channels.index(channel)]
        return sums


SparseColumns = Sequence[Sequence[SparseDerivatives]]  # Columns by parameter and flight


def drop_zero_channels(flights: Sequence[NDArray[np.floating]]) -> list[SparseDerivatives]:
    """Return derivatives (T, C, P) in single precision, without channels that are zero in all flights."""
    moved = tuple(np.flatnonzero(np.any([has_nonzero(part, axis=0).any(axis=1) for part in flights], axis=0)).tolist())
    return [
        SparseDerivatives(values=part.T[:, list(moved)].astype(np.float32).T, channels=moved, width=part.shape[2])
        for part in flights
    ]


def split_columns(flights: Sequence[NDArray[np.floating]]) -> SparseColumns:
    """Return each column of derivatives (T, C, P) stored sparsely by itself."""
    return [drop_zero_channels([part[:, :, k : k + 1] for part in flights]) for k in range(flights[0].shape[2])]


def join_columns(columns: SparseColumns, channels: int) -> list[NDArray[np.floating]]:
    """Return columns as dense derivatives of each flight, (T, C, P)."""
    flights = zip(*columns, strict=True)
    return [np.concatenate([one.dense_columns(range(channels)) for one in own], axis=2) for own in flights]


def correct_sparse_columns(columns: SparseColumns, step: Array, change: Sequence[Array]) -> SparseColumns:
    """Return single columns after the least correction that gives ``change`` (T, C) of each flight over a ``step`` (K,).

    Source: Schubert (1970), Modification of a quasi-Newton method for nonlinear equations with a sparse Jacobian,
    Mathematics of Computation 24.
    """
    size, missed = (
        np.full(change[0].shape[1], 1e-30),
        [part.astype(np.float32) for part in change],
    )  # not 0 without a step
    for k, own in enumerate(columns):
        size[list(own[0].channels)] += step[k] ** 2  # of the columns that are nonzero in a channel
        for rows, one in zip(missed, own, strict=True):
            rows[:, one.channels] -= np.float32(step[k]) * one.values[:, :, 0]

    def correct(one: SparseDerivatives, share: Array, rows: NDArray[np.floating]) -> SparseDerivatives:
        return replace(one, values=one.values + (share.astype(np.float32) * rows)[:, one.channels, None])

    shares = step[:, None] / size
    return [list(map(correct, own, [share] * len(own), missed)) for own, share in zip(columns, shares, strict=True)]


Part = NDArray[np.floating] | SparseDerivatives  # Derivatives of a flight by some parameters, (T, C, P)


IndexedColumns = tuple[Indices, Array]  # Indices among all columns, and their values (T, k)


def num_columns(parts: Sequence[Part]) -> int:
    """Return the total number K of parameters."""
    return sum(part.width if isinstance(part, SparseDerivatives) else part.shape[2] for part in parts)


class DerivativesWithWeights:
    """Derivatives of all flights by K parameters, times the square root of the channel weights."""

    def __init__(
        self, flights: Sequence[Sequence[Part]], offsets: FlightOffsets, *,
        first: "DerivativesWithWeights | None" = None,
    ) -> None:  # fmt: skip
        """Store the parts of each flight, consecutive among the K columns, with random flight ``offsets`` integrated out.

        Columns ``first``, with the same weights and offsets, come before them and are shared.
        """
        start = 0 if first is None else first.width
        self.width = start + num_columns(flights[0])
        root = np.sqrt(offsets.weight)
        by_flight = map_in_threads(lambda parts: _nonzero_columns_with_weights(parts, root, start), flights)
        self.columns = [[[one] for one in of_flight] for of_flight in by_flight]
        """By flight and channel: blocks of indices among the K columns, and their values (T, k)."""
        for own in self.columns if offsets.has_offsets else ():
            for channel in np.flatnonzero(offsets.size):
                ((_, columns),) = own[channel]
                if columns.size:
                    columns -= offsets.share_of_mean(len(columns))[channel] * columns.mean(axis=0)
        if first is not None:
            pairs = zip(first.columns, self.columns, strict=True)
            self.columns = [[a + b for a, b in zip(one, other, strict=True)] for one, other in pairs]


def _nonzero_columns_with_weights(parts: Sequence[Part], root: Array, start: int = 0) -> list[IndexedColumns]:
    """Return the nonzero columns of each channel: their indices from ``start`` on, and values times ``root``, (T, k)."""
    sums: list[tuple[list[Indices], list[Array]]] = [([], []) for _ in root]
    for part in parts:
        if isinstance(part, SparseDerivatives):
            values, channels, first = part.values, part.channels, start + part.first
        else:
            values, channels, first = part, range(root.size), start
        # A single column has no zero channels; in few flights it is zero, which only takes time.
        moving = np.ones((len(channels), 1), dtype=bool) if values.shape[2] == 1 else has_nonzero(values, axis=0)
        for own, channel in enumerate(channels):
            if (some := moving[own]).any():
                sums[channel][0].append(np.flatnonzero(some) + first)
                sums[channel][1].append(values[:, own] if some.all() else values[:, own][:, some])
        start += num_columns([part])
    results = list[IndexedColumns]()
    for factor, (places, columns) in zip(root.tolist(), sums, strict=True):
        if not places:
            results.append((np.zeros(0, dtype=np.int64), np.zeros((0, 0))))
            continue
        joined = np.concatenate([one.T for one in columns], dtype=np.float64)
        joined *= factor  # in place, as the columns are large
        results.append((np.concatenate(places), joined.T))
    return results


def sum_of_products(one: DerivativesWithWeights, other: DerivativesWithWeights) -> Array:
    """Return ``sum w J_one J_other^T`` over all rows, (K, K')."""
    sums = np.zeros((one.width, other.width))
    for left, right in zip(one.columns, other.columns, strict=True):
        for here, a, there, b in _pairs_of_columns(left, right):
            sums[here[:, None], there] += a.T @ b
    return sums


def _pairs_of_columns(
    one: Sequence[Sequence[IndexedColumns]], other: Sequence[Sequence[IndexedColumns]]
) -> Iterator[tuple[Indices, Array, Indices, Array]]:
    """Yield the pairs of blocks of columns in each channel of a flight that have any."""
    for left, right in zip(one, other, strict=True):
        yield from ((*a, *b) for a in left for b in right if a[0].size and b[0].size)


class TimeBlocks:
    """Equal parts of flights, with sums over them."""

    def __init__(self, times: Sequence[Array], parts: int = 1) -> None:
        """Store the row times of each flight [s] and the number of parts per flight."""
        split = [own for time in times for own in np.array_split(np.arange(time.size), parts)]
        self.rows = [slice(int(own[0]), int(own[-1]) + 1) for own in split]
        self.of_flight = [range(first, first + parts) for first in range(0, len(split), parts)]
        self.flight = np.repeat(np.arange(len(times)), parts)
        self.count = np.array([float(own.size) for own in split])

    def block_products(self, one: DerivativesWithWeights, other: DerivativesWithWeights) -> Array:
        """Return ``sum w J_one J_other^T`` of each block, (B, K, K')."""
        sums = np.zeros((len(self.rows), one.width, other.width))
        for flight, (left, right) in enumerate(zip(one.columns, other.columns, strict=True)):
            self.add_products_of_flight(sums, flight, left, right)
        return sums

    def add_products_of_flight(
        self, sums: Array, flight: int, one: Sequence[Sequence[IndexedColumns]],
        other: Sequence[Sequence[IndexedColumns]],
    ) -> None:  # fmt: skip
        """Add a flight's products to the sums of its blocks, (B, K, K'); ``one`` and ``other`` are columns by channel."""
        for here, a, there, b in _pairs_of_columns(one, other):
            place = (here[:, None] * sums.shape[2] + there).ravel()
            for block in self.of_flight[flight]:
                rows = self.rows[block]
                sums[block].reshape(-1)[place] += (a[rows].T @ b[rows]).ravel()


class NuisanceSums:
    """Nuisance columns (tolerances and structures), with the sums that all effects share."""

    def __init__(
        self, times: Sequence[Array], flights: Sequence[Sequence[Part]], weight: Array, *, parts: int = 1,
        offsets: FlightOffsets | None = None, first: DerivativesWithWeights | None = None,
    ) -> None:  # fmt: skip
        """Take row times [s], derivatives and the weight of one row (C,); random flight ``offsets`` are integrated out.

        Columns ``first`` come before the others.
        """
        none = np.zeros(weight.size)
        self.offsets = offsets or FlightOffsets(size=none, weight=weight, most=none)
        self.log_likelihood = self.offsets.log_likelihood([time.size for time in times])
        """Log likelihood term of the offsets, in addition to the squares."""

        self.blocks = TimeBlocks(times, parts)
        self.first, self.columns = first, DerivativesWithWeights(flights, self.offsets, first=first)
        self.product = self.blocks.block_products(self.columns, self.columns)
        """Sums of products of each block, (B, N, N)."""

        self.whole = self.product.sum(axis=0)
        """Sums over all blocks, (N, N)."""

    @property
    def width(self) -> int:
        """Return the number of nuisance columns N."""
        return self.columns.width

    def moments_with_effects(self, residuals: Sequence[Array], own: Sequence[Array]) -> Moments:
        """Return block sums over all channels: effects, by residuals (T, C) and derivatives (T, C, P), then nuisances."""
        width, blocks = own[0].shape[2], len(self.blocks.rows)
        inner, across = (np.zeros((blocks, width + 1, count)) for count in (width + 1, self.width))
        for flight, (j, r, beside) in enumerate(zip(own, residuals, self.columns.columns, strict=True)):
            (front,) = DerivativesWithWeights([(j, r[:, :, None])], self.offsets).columns  # large, so one at a time
            self.blocks.add_products_of_flight(inner, flight, front, front)
            self.blocks.add_products_of_flight(across, flight, front, beside)
        product = np.block(
            [[inner[:, :width, :width], across[:, :width]], [across[:, :width].transpose(0, 2, 1), self.product]]
        )
        gradient = np.concatenate((inner[:, :width, width], across[:, width]), axis=1)
        square, count, flight = inner[:, width, width, None], self.blocks.count, self.blocks.flight
        return Moments(count=count, square=square, gradient=gradient[:, None], product=product[:, None], flight=flight)


def weighted_moments(
    times: Sequence[Array], residuals: Sequence[Array], flights: Sequence[Sequence[Part]], weight: Array, *,
    parts: int = 1,
) -> Moments:  # fmt: skip
    """Return the block sums over all channels as one channel of weight 1, flight by flight to save memory."""

    def moments_of_flight(flight: tuple[Array, Array, Sequence[Part]]) -> Moments:
        time, r, own = flight
        return NuisanceSums([time], [own], weight, parts=parts).moments_with_effects([r], [np.zeros((*r.shape, 0))])

    return concatenate_moments(map_in_threads(moments_of_flight, list(zip(times, residuals, flights, strict=True))))


def moments_by_channel(residuals: Sequence[Array], flights: Sequence[Sequence[Part]]) -> Moments:
    """Return the sums over whole flights by channel, like ``block_moments`` with infinite length."""
    channels, width = residuals[0].shape[1], num_columns(flights[0])
    sums = np.zeros((len(flights), channels, width + 1, width + 1))
    for own, parts, residual in zip(sums, flights, residuals, strict=True):
        for product, (here, columns) in zip(
            own, _nonzero_columns_with_weights([*parts, residual[:, :, None]], np.ones(channels)), strict=True
        ):
            product[np.ix_(here, here)] = columns.T @ columns
    count, flight = np.array([float(len(residual)) for residual in residuals]), np.arange(len(flights))
    square, gradient, product = sums[:, :, width, width], sums[:, :, :width, width], sums[:, :, :width, :width]
    return Moments(count=count, square=square, gradient=gradient, product=product, flight=flight)
