"""What is stated of means is checked against closed forms. Zeros found by their bits."""

import numpy as np
import pytest
from scipy import stats

from aerial_gym.sim2real.arrays import has_nonzero
from aerial_gym.sim2real.statistics import (
    bin_means,
    chi_square_tail,
    fit_line,
    normal_quantile,
    normal_tail,
    ratio_quantile,
    student_quantile,
    student_tail,
)


def test_independent_samples_have_the_textbook_standard_error() -> None:
    """Every sample a group of its own: mean and ``s / sqrt(n)`` of each bin, exactly."""
    rng = np.random.default_rng(0)
    values, place = rng.standard_normal((90, 2)), rng.integers(0, 3, 90)
    result = bin_means(values, place, 4, np.arange(90))
    for b in range(3):
        own = values[place == b]
        assert result.count[b] == len(own)
        np.testing.assert_allclose(result.mean[b], own.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(result.std_error[b], own.std(axis=0, ddof=1) / np.sqrt(len(own)), rtol=1e-12)
    assert result.count[3] == 0
    assert np.isnan(result.mean[3]).all()
    assert np.isnan(result.std_error[3]).all()


def test_the_standard_error_holds_where_neighbours_are_alike() -> None:
    """Groups with an offset of 0.5 and noise of 1: the variance of a mean of G groups of m is 0.25 / G + 1 / (G m), here 11
    times what independent samples would have. 3000 trials of 20 groups know it to 3 %."""
    rng, groups, size = np.random.default_rng(1), 20, 40
    group, place = np.repeat(np.arange(groups), size), np.zeros(groups * size, dtype=int)
    variances = []
    for _ in range(3000):
        values = rng.standard_normal((groups * size, 1)) + 0.5 * rng.standard_normal(groups)[group][:, None]
        variances.append(bin_means(values, place, 1, group).std_error[0, 0] ** 2)
    truth = 0.25 / groups + 1.0 / (groups * size)
    assert abs(np.mean(variances) / truth - 1.0) < 0.03


@pytest.mark.slow
def test_two_of_three_bars_hold_the_truth_however_few_groups_there_are() -> None:
    """Half widths of one standard error by Student's t: 68.3 % of 4000 trials with 2, 3 or 12 groups, each known to 0.74 %."""
    rng = np.random.default_rng(2)
    for groups in (2, 3, 12):
        group, inside = np.repeat(np.arange(groups), 10), 0
        for _ in range(4000):
            result = bin_means(rng.standard_normal((groups, 1))[group], np.zeros(group.size, dtype=int), 1, group)
            inside += abs(result.mean[0, 0]) < result.half_width[0, 0]
        assert abs(inside / 4000 - 0.683) < 4.0 * 0.0074


def test_one_group_has_no_standard_error() -> None:
    result = bin_means(np.ones((5, 1)), np.zeros(5, dtype=int), 1, np.zeros(5, dtype=int))
    assert result.mean[0, 0] == 1.0
    assert np.isnan(result.std_error[0, 0])


@pytest.mark.parametrize("freedom", [1, 4, 300])
def test_distributions_are_those_of_scipy(freedom: int) -> None:
    for value in (-3.0, 0.2, 9.0):
        assert normal_tail(value) == pytest.approx(stats.norm.sf(value), rel=1e-13)
        assert student_tail(value, freedom) == pytest.approx(stats.t.sf(value, freedom), rel=1e-13)
        assert chi_square_tail(value, freedom) == pytest.approx(stats.chi2.sf(value, freedom), rel=1e-13)
    for share in (1e-6, 0.3, 0.975):
        assert normal_quantile(share) == pytest.approx(stats.norm.ppf(share), rel=1e-13)
        assert student_quantile(share, freedom) == pytest.approx(stats.t.ppf(share, freedom), rel=1e-13)
        assert ratio_quantile(share, 3, freedom) == pytest.approx(stats.f.ppf(share, 3, freedom), rel=1e-12)


def test_the_line_through_points_is_that_of_scipy() -> None:
    x, noise = np.random.default_rng(3).standard_normal((2, 40))
    expected = stats.linregress(x, 2.0 + 0.3 * x + noise)
    values = np.array(expected)
    np.testing.assert_allclose(fit_line(x, 2.0 + 0.3 * x + noise), values[[0, 1, 3]], rtol=1e-9)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_one_number_is_enough_whatever_it_is(dtype: type) -> None:
    rows = np.zeros((200, 6), dtype=dtype)
    rows[17, 1], rows[199, 2], rows[0, 3], rows[50, 4] = np.finfo(dtype).smallest_subnormal, np.nan, -1.0, -0.0
    expected = [False, True, True, True, False, False]
    assert has_nonzero(rows, axis=0).tolist() == expected
    assert has_nonzero(np.ascontiguousarray(rows.T), axis=1).tolist() == expected
    assert has_nonzero(rows[:, ::2], axis=0).tolist() == expected[::2]
    assert has_nonzero(rows.reshape(200, 2, 3), axis=0).tolist() == [expected[:3], expected[3:]]
