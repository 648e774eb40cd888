"""Columns that are brought into the band: those that have not changed are not filtered again.

Letters: E rows, T rows kept, K columns.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEPT = 3
"""Results kept of each column: first the one asked for most, that of the model about which others differ."""


class SlowColumns:
    """A filter that works on each column by itself, with its last results."""

    def __init__(self, slow: Callable[[Array], Array]) -> None:
        """Take the filter of columns, (any, E) to (any, T)."""
        self._slow = slow
        self._known: dict[int, list[tuple[Array, Array]]] = {}

    def of(self, rows: Array) -> list[Array]:
        """Return the columns of the rows (E, K) in the band, each (T,); not to be written to."""
        columns = np.ascontiguousarray(rows.T)
        found: list[Array | None] = [self._recalled(place, column) for place, column in enumerate(columns)]
        new = [place for place, column in enumerate(found) if column is None]
        slow = self._slow(columns[new]) if new else ()
        for place, column in zip(new, slow, strict=True):
            alone = column.copy()  # it may outlive the others
            kept = self._known.setdefault(place, [])
            kept.insert(1, (columns[place].copy(), alone))
            found[place] = alone
            del kept[KEPT:]
        return [column for column in found if column is not None]

    def _recalled(self, place: int, column: Array) -> Array | None:
        kept = self._known.get(place, [])
        for number, (before, found) in enumerate(kept):
            if np.array_equal(column, before):
                kept.insert(0, kept.pop(number))
                return found
        return None
