"""Fewer points that keep every extreme."""

import numpy as np
import pytest

from aerial_gym.viewer.time_plots import MOST_POINTS, envelope


def test_few_samples_stay_as_they_are() -> None:
    time, lines = np.arange(5.0), np.arange(10.0).reshape(2, 5)
    assert envelope(time, lines, 6) == (time, lines) or all(
        np.array_equal(a, b) for a, b in zip(envelope(time, lines, 6), (time, lines), strict=True)
    )


@pytest.mark.parametrize("count", [MOST_POINTS + 1, 3001, 240_000])
def test_a_spike_of_one_sample_stays(count: int) -> None:
    time, lines = np.arange(count) / 200.0, np.zeros((2, count))
    lines[0, count // 3], lines[1, count // 2] = 7.0, -3.0
    lines[1, 10] = np.nan
    short, thin = envelope(time, lines)
    assert short.size == thin.shape[1] <= MOST_POINTS + 2
    assert (np.diff(short) >= 0.0).all()
    assert (short[0], short[-1]) == (time[0], time[-1])
    assert (thin[0].max(), np.nanmin(thin[1])) == (7.0, -3.0)
    assert short[np.argmax(thin[0])] == pytest.approx(time[count // 3], abs=2.0 * count / MOST_POINTS / 200.0)
