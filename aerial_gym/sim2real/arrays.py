"""Type aliases of arrays, with shapes and units where an array is used, spans of flags, and a fast test for nonzero numbers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]


def true_spans(flags: Flags) -> list[tuple[int, int]]:
    """Return first row and end of each run of true flags, (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return [(first, end) for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]


def has_nonzero(table: NDArray[np.floating], axis: int | tuple[int, ...]) -> Flags:
    """Return ``(table != 0).any(axis)``, NaN included, by a much faster test of the bits."""
    bits = np.bitwise_or.reduce(table.view(f"u{table.itemsize}"), axis=axis)
    return bits << 1 != 0  # without the sign bit
