"""Splines through the rows of several flights, against scipy's through those of each."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from aerial_gym.sim2real.predict.rows.spline import Spline


@pytest.mark.parametrize("rows", [(40, 25), (40, 4), (3, 9), (2, 2), (30, 1)])
def test_each_flight_has_the_spline_through_its_own_rows(rows: tuple[int, int]) -> None:
    """Rows with a gap where the vehicle stood, one flight early and one late, beyond its last row as well."""
    rng = np.random.default_rng(sum(rows))
    times = [np.cumsum(rng.choice([0.03, 0.03, 0.3], size)) for size in rows]
    columns, late = [rng.standard_normal(sum(rows)) for _ in range(2)], (0.012, -0.02)
    spline = Spline(times)
    for seconds in (late, late[::-1], late):  # what is kept of one pair of delays does not serve another
        found = spline.later(columns, seconds)
        for column, moved in zip(columns, found, strict=True):
            first = 0
            for time, delay in zip(times, seconds, strict=True):
                own = column[first : first + time.size]
                expected = CubicSpline(time, own)(time - delay) if time.size > 1 else own
                np.testing.assert_allclose(moved[first : first + time.size], expected, atol=1e-9)
                first += time.size


def test_what_is_not_late_stays_as_it_is() -> None:
    columns = [np.arange(5.0), np.ones(5)]
    assert all(a is b for a, b in zip(Spline([np.arange(5.0)]).later(columns, (0.0,)), columns, strict=True))
