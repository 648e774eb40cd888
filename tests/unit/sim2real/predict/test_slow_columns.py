"""Columns that have not changed are not filtered again, and come out as if they were."""

import numpy as np

from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.slow_columns import SlowColumns


def test_only_columns_that_changed_are_filtered() -> None:
    asked: list[int] = []

    def slow(columns: np.ndarray) -> np.ndarray:
        asked.append(len(columns))
        return lowpass(columns.T, 100.0, 10.0)[::3].T

    rng = np.random.default_rng(0)
    columns, base = SlowColumns(slow), rng.normal(size=(300, 4))
    for place in (None, 2, 0, 3, 2, None):
        rows = base.copy()
        if place is not None:
            rows[:, place] += rng.normal(size=300)
        np.testing.assert_array_equal(np.stack(columns.of(rows), axis=1), lowpass(rows, 100.0, 10.0)[::3])
    assert asked == [4, 1, 1, 1, 1]
