"""Times at which drifting parameters cross limits."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.fleet.statistics import Change, time_to_limit

DRIFT = Change(
    effect="weak_motor", rotor=2, kind="drift", log_evidence=50.0, onset=10, onset_low=9, onset_high=11,
    parameters=("scale",), change=(-0.05,), std=(0.005,), level=(0.95,), level_std=(0.004,), slope=(-0.005,),
    slope_std=(0.0008,), level_slope_cov=(1.5e-6,), last_time=30.0,
)  # fmt: skip


def test_quantiles_of_the_crossing() -> None:
    """Against 200,000 draws of level and slope: the times by which the lines of 50, 5 and 95 % are beyond the limit."""
    rng = np.random.default_rng(0)
    cov = [[0.004**2, 1.5e-6], [1.5e-6, 0.0008**2]]
    level, slope = rng.multivariate_normal([0.95, -0.005], cov, 200_000).T
    times = 30.0 + (0.9 - level) / slope
    np.testing.assert_allclose(time_to_limit(DRIFT, 0.9), np.quantile(times, (0.5, 0.05, 0.95)), rtol=3e-3)


def test_median_is_where_the_line_crosses() -> None:
    for limit in (0.97, 0.9):
        median, low, high = time_to_limit(DRIFT, limit) or (0.0, 0.0, 0.0)
        np.testing.assert_allclose(median, 30.0 + (0.95 - limit) / 0.005, rtol=1e-9)
        assert low < median < high


def test_crossing_is_not_before_the_onset() -> None:
    times = time_to_limit(replace(DRIFT, level_std=(0.1,)), 0.999)
    assert times is not None
    assert times[1] == 20.0


@pytest.mark.parametrize(
    "change",
    [
        replace(DRIFT, kind="step", slope=(0.0,)),
        replace(DRIFT, kind=""),
        replace(DRIFT, change=(0.05,), slope=(0.005,)),
    ],
)
def test_no_crossing_of_a_step_or_away_from_the_limit(change: Change) -> None:
    assert time_to_limit(change, 0.85) is None


def test_end_of_an_uncertain_drift_is_infinite() -> None:
    median, low, high = time_to_limit(replace(DRIFT, slope_std=(0.004,)), 0.9) or (0.0, 0.0, 0.0)
    assert low < median < high == np.inf


def test_parameter_is_chosen_by_name() -> None:
    names = ("change", "std", "level", "level_std", "slope", "slope_std", "level_slope_cov")
    both = replace(DRIFT, parameters=("a", "scale"), **{name: (0.0, *getattr(DRIFT, name)) for name in names})
    assert time_to_limit(both, 0.9, "scale") == time_to_limit(DRIFT, 0.9)
    assert time_to_limit(both, 0.9) is None
