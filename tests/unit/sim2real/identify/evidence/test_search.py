"""The search against all subsets of small libraries, and what competing sets must do."""

from dataclasses import replace
from itertools import chain, combinations

import numpy as np
import pytest

from aerial_gym.sim2real.identify.evidence.search import SetPosterior, search_sets
from tests.unit.sim2real.identify.evidence.linear import candidates, normal


def all_subsets(count: int) -> list[tuple[int, ...]]:
    return list(chain.from_iterable(combinations(range(count), size) for size in range(count + 1)))


@pytest.mark.parametrize("seed", range(12))
def test_the_search_finds_what_looking_at_every_subset_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(60, 9)) @ (np.eye(9) + 0.6 * rng.normal(size=(9, 9)))
    truth = np.where(rng.random(9) < 0.4, rng.normal(size=9), 0.0)
    sums = normal(columns, columns @ truth + rng.normal(size=60))
    made_of = candidates(*[1] * 7, num_tolerances=2)
    result, whole = search_sets(made_of, sums), SetPosterior(candidates=made_of, normal=sums)
    whole.log_posteriors(all_subsets(7))
    assert result.most_probable_set == whole.most_probable_set
    for name, probability in whole.inclusion().items():
        assert result.inclusion()[name] == pytest.approx(probability, abs=0.05)


def test_two_effects_that_each_alone_would_spoil_are_found_together() -> None:
    rng = np.random.default_rng(1)
    common, own = rng.normal(size=200), rng.normal(size=200)
    columns = np.stack((10.0 * common + own, -10.0 * common + own, rng.normal(size=200)), axis=1)
    sums = normal(columns, columns @ np.array([1.0, 1.0, 0.0]) + 0.1 * rng.normal(size=200))
    sets = search_sets(candidates(1, 1, 1), sums)
    assert sets.most_probable_set == (0, 1)
    assert sets.log_posteriors([(0,)])[0] < sets.log_posteriors([()])[0] + 1.0
    assert sets.log_posteriors([(1,)])[0] < sets.log_posteriors([()])[0] + 1.0


def test_two_effects_that_replace_each_other_share_the_probability_and_neither_goes() -> None:
    rng = np.random.default_rng(2)
    column = rng.normal(size=100)
    sums = normal(np.stack((column, column), axis=1), column + rng.normal(size=100))
    inclusion = search_sets(candidates(1, 1), sums).inclusion()
    assert inclusion["effect_0"] == pytest.approx(inclusion["effect_1"], rel=1e-6)
    assert 0.4 < inclusion["effect_0"] < 0.7


def test_a_set_has_no_two_candidates_of_one_name() -> None:
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(100, 2))
    sums = normal(columns, columns @ np.array([1.0, 1.0]) + 0.1 * rng.normal(size=100))
    sets = search_sets(candidates(1, 1, names=("load", "load")), sums)
    assert len(sets.most_probable_set) == 1
    assert all(len(model) < 2 for model in sets.log_posterior)


@pytest.mark.parametrize("count", [3, 20])
def test_a_long_list_finds_nothing_in_noise_by_its_length(count: int) -> None:
    """Each name costs log(number of names): the mean probability of the empty set falls by a few per cent from 3 to 20."""
    shares = []
    for seed in range(8):
        rng = np.random.default_rng([count, seed])
        sums = normal(30.0 * rng.normal(size=(50, count)), rng.normal(size=50))
        shares.append(search_sets(candidates(*[1] * count), sums).probabilities()[()])
    assert np.mean(shares) > 0.85


def test_a_wide_case_and_what_it_contains_are_never_in_one_set() -> None:
    rng = np.random.default_rng(7)
    columns = rng.normal(size=(100, 2))
    sums = normal(columns, columns @ np.array([1.0, 1.0]) + 0.1 * rng.normal(size=100))
    apart = replace(candidates(1, 1), apart=frozenset({frozenset({"effect_0", "effect_1"})}))
    assert search_sets(candidates(1, 1), sums).most_probable_set == (0, 1)
    assert len(search_sets(apart, sums).most_probable_set) == 1
