"""Zeros found by their bits."""

import numpy as np
import pytest

from aerial_gym.sim2real.arrays import has_nonzero


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_one_number_is_enough_whatever_it_is(dtype: type) -> None:
    rows = np.zeros((200, 6), dtype=dtype)
    rows[17, 1], rows[199, 2], rows[0, 3], rows[50, 4] = np.finfo(dtype).smallest_subnormal, np.nan, -1.0, -0.0
    expected = [False, True, True, True, False, False]
    assert has_nonzero(rows, axis=0).tolist() == expected
    assert has_nonzero(np.ascontiguousarray(rows.T), axis=1).tolist() == expected
    assert has_nonzero(rows[:, ::2], axis=0).tolist() == expected[::2]
    assert has_nonzero(rows.reshape(200, 2, 3), axis=0).tolist() == [expected[:3], expected[3:]]
