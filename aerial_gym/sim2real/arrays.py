"""Type aliases of arrays, with shapes and units where an array is used, spans of flags, and a fast test for nonzero numbers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

SPACING = 61  # Rows from one number that ``has_nonzero`` reads first to the next


def true_spans(flags: Flags) -> list[tuple[int, int]]:
    """Return first row and end of each run of true flags, (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return [(first, end) for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]


def has_nonzero(table: NDArray[np.floating], axis: int) -> Flags:
    """Return ``(table != 0).any(axis)``, NaN included, from the bits of a few numbers, and from all numbers if those are 0."""
    rows = np.moveaxis(table, axis, 0)
    results = np.bitwise_or.reduce(rows[::SPACING].view(f"u{table.itemsize}"), axis=0) << 1 != 0  # without the sign bit
    if not results.all():
        results[~results] = (rows[:, ~results] != 0).any(axis=0)
    return results
