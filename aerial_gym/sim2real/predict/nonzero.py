"""Which columns of a table are zero in all rows."""

import numpy as np
from numpy.typing import NDArray

SEEN_FIRST = 64
"""Rows at which a look is taken first: most columns that are not zero show it there."""


def nonzero_columns(rows: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the columns of rows (E, K) that are not zero in every row."""
    found = rows[:: -(-len(rows) // SEEN_FIRST)].any(axis=0) if len(rows) else np.zeros(rows.shape[1], dtype=bool)
    for place in np.flatnonzero(~found):
        found[place] = rows[:, place].any()
    return np.flatnonzero(found)
