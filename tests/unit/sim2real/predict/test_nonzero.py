"""Columns of zeros, found by a look at some rows first."""

import numpy as np

from aerial_gym.sim2real.predict.nonzero import SEEN_FIRST, nonzero_columns


def test_a_column_is_zero_only_if_every_row_is() -> None:
    """One number is enough, wherever it stands; so is one that is no number."""
    for count in (1, SEEN_FIRST, 5 * SEEN_FIRST + 3):
        for row in (0, 1 % count, count // 2, count - 1):
            rows = np.zeros((count, 4))
            rows[row, 1], rows[row, 3] = 1e-300, np.nan
            np.testing.assert_array_equal(nonzero_columns(rows), [1, 3])
    assert nonzero_columns(np.zeros((0, 3))).size == 0
