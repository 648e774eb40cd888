"""A decaying sum is what a loop over rows makes."""

import numpy as np
import pytest

from aerial_gym.math.decay import exponential_sum


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.999, 1.0])
@pytest.mark.parametrize("rows", [1, 2, 300])
def test_it_is_what_a_loop_over_rows_makes(rows: int, kept: float) -> None:
    """``y_n = kept y_(n-1) + x_n``, and the rows that were given stay as they are."""
    added = np.random.default_rng(0).normal(size=(rows, 2))
    before, expected = added.copy(), added[:1].copy()
    for row in added[1:]:
        expected = np.append(expected, (kept * expected[-1] + row)[None], axis=0)
    np.testing.assert_allclose(exponential_sum(added, kept), expected, atol=1e-12)
    np.testing.assert_array_equal(added, before)
