"""The evidence of one set against other integrals, and the search against all subsets of small libraries."""

from dataclasses import replace
from itertools import chain, combinations

import numpy as np
import pytest
from scipy import integrate, stats

from aerial_gym.sim2real.identify.evidence.laplace import Candidates, NormalEquations, log_evidences, posterior
from aerial_gym.sim2real.identify.evidence.search import SetPosterior, search_sets
from tests.unit.sim2real.identify.evidence.linear import candidates, normal


@pytest.mark.parametrize(("made_of", "model"), [
    (candidates(num_tolerances=3), ()), (replace(candidates(3), structures=frozenset({0})), (0,)),
], ids=["tolerances", "a structure"])  # fmt: skip
def test_with_normal_priors_the_evidence_is_that_of_a_normal_model(made_of: Candidates, model: tuple[int, ...]) -> None:
    """``log Z = log N(y; 0, I + J J^T) - log N(y; 0, I)`` exactly."""
    rng = np.random.default_rng(0)
    columns, measured = rng.normal(size=(12, 3)), rng.normal(size=12)
    result = posterior(made_of, normal(columns, measured), model).log_evidence
    wide, white = (stats.multivariate_normal(cov=cov) for cov in (np.eye(12) + columns @ columns.T, np.eye(12)))
    assert result == pytest.approx(wide.logpdf(measured) - white.logpdf(measured), abs=1e-9)


@pytest.mark.parametrize("low", [-np.inf, 0.0])
@pytest.mark.parametrize("best", [-1.0, 0.3, 4.0, 20.0])
def test_the_evidence_of_one_parameter_is_its_integral_over_the_prior(best: float, low: float) -> None:
    """Data that tell the parameter to 0.05 of its scale: Laplace is good to some per cent, also across a bound. Where
    the best value lies beyond the bound the prior is taken there: wrong by its change up to the bound at most."""
    precision = 400.0
    result = posterior(
        candidates(1, low=low),
        NormalEquations(product=np.array([[precision]]), gradient=np.array([precision * best])),
        (0,),
    )
    peak = max(best, low)
    whole = 1.0 - stats.cauchy.cdf(low) if np.isfinite(low) else 1.0

    def density(x: float) -> float:
        return stats.cauchy.pdf(x) / whole * np.exp(precision * (best * x - 0.5 * x**2) - shift)

    shift = precision * (best * peak - 0.5 * peak**2)
    exact = np.log(integrate.quad(density, max(low, peak - 0.5), peak + 0.5, points=[peak])[0]) + shift
    beyond = np.log(stats.cauchy.pdf(peak) / stats.cauchy.pdf(best))
    assert result.log_evidence == pytest.approx(exact, abs=0.05 + beyond)


def test_a_parameter_that_nothing_shows_costs_little_and_gains_nothing() -> None:
    """Then the exact evidence is 1; the normal approximation of a Cauchy prior has sqrt(1 / pi) = 0.56 of it."""
    result = posterior(candidates(1), NormalEquations(product=np.zeros((1, 1)), gradient=np.zeros(1)), (0,))
    assert result.log_evidence == pytest.approx(0.5 * np.log(1.0 / np.pi), abs=1e-6)


def test_a_large_parameter_is_not_held_back_by_its_prior() -> None:
    """At ten scales a normal prior would pull by a tenth of a standard deviation of the data each; Cauchy's tails do not."""
    result = posterior(candidates(1), NormalEquations(product=np.array([[4.0]]), gradient=np.array([40.0])), (0,))
    assert result.step[0] == pytest.approx(10.0, abs=0.06)


def test_a_deviation_beyond_its_tolerance_pays_for_an_effect() -> None:
    """What five standard deviations of a tolerance explain, an effect of half its scale explains without that cost."""
    columns = np.array([[10.0, 1.0]])  # the effect moves the reading by 10 per scale, the tolerance by 1 a deviation
    sums = normal(np.repeat(columns, 100, axis=0), np.full(100, 5.0))
    both = candidates(1, num_tolerances=1)
    gain = posterior(both, sums, (0,)).log_evidence - posterior(both, sums, ()).log_evidence
    assert 7.0 < gain < 12.5  # half the square of 5, less what the width of the prior costs


def test_columns_that_are_in_every_set_may_be_integrated_out_once() -> None:
    rng = np.random.default_rng(4)
    sums, made_of = normal(rng.normal(size=(40, 5)), rng.normal(size=40)), candidates(2, 1, num_tolerances=2)
    once = sums.marginal(made_of.tolerances)
    for model in ((), (0,), (1,), (0, 1)):
        reduced = posterior(made_of.without_tolerances(), once, model).log_evidence
        assert reduced == pytest.approx(posterior(made_of, sums, model).log_evidence, abs=1e-9)


def test_many_sets_at_once_have_the_evidence_of_each() -> None:
    rng = np.random.default_rng(7)
    sums = normal(rng.normal(size=(60, 12)), rng.normal(size=60))
    made_of = replace(candidates(2, 1, 3, 2, 1, 2, low=-0.1, num_tolerances=1), structures=frozenset({2, 3, 4, 5}))
    structures = [own for count in range(4) for own in combinations((2, 3, 4, 5), count)]
    up_to_three = [(*effects, *own) for own in structures for effects in ((), (0,), (0, 1))]
    whole = tuple(range(6))
    for models in (up_to_three, [whole, *combinations(whole, 5)], [(0, 2, 3), (0, 2)], [(), (1,), (0, 1)]):
        expected = [posterior(made_of, sums, model).log_evidence for model in models]
        np.testing.assert_allclose(log_evidences(made_of, sums, models), expected, atol=1e-9)


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


def test_a_set_has_no_two_candidates_of_one_name_and_no_case_beside_a_wider_one() -> None:
    columns = np.random.default_rng(3).normal(size=(100, 2))
    sums = normal(columns, columns.sum(axis=1) + 0.1 * np.random.default_rng(7).normal(size=100))
    apart = replace(candidates(1, 1), apart=frozenset({frozenset({"effect_0", "effect_1"})}))
    assert search_sets(candidates(1, 1), sums).most_probable_set == (0, 1)
    for made_of in (candidates(1, 1, names=("load", "load")), apart):
        sets = search_sets(made_of, sums)
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
