"""What speaks for an effect when parameters scatter between flights."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from aerial_gym.sim2real.identify.candidates.library import Candidate, Library
from aerial_gym.sim2real.identify.evidence.guard import Guard, Support, num_parts_per_flight, supports_of_candidates
from aerial_gym.sim2real.identify.evidence.laplace import NormalEquations, posterior
from aerial_gym.sim2real.identify.evidence.linear import make_candidates, make_normal_equations
from aerial_gym.sim2real.identify.evidence.search import search_sets
from aerial_gym.sim2real.identify.least_squares.moments import Moments
from tests.unit.sim2real.identify.evidence.linear import candidates

Array = NDArray[np.float64]

ROWS = 400.0
"""Of each flight, each with noise of one."""


def of_flights(values: Array) -> list[NormalEquations]:
    """Return the sums of flights that each ask for a value of one parameter, (F,)."""
    return [NormalEquations(product=np.full((1, 1), ROWS), gradient=np.array([ROWS * value])) for value in values]


def make_support(whole: NormalEquations, parts: list[NormalEquations]) -> Support:
    """Return the support of one parameter with log odds of 100."""
    return supports_of_candidates(candidates(1), whole, parts, posterior(candidates(1), whole, (0,)).step, {0: 100.0})[
        0
    ]


@pytest.mark.parametrize("spread", [0.0, 0.05, 0.2])
def test_overdispersion_is_the_variance_between_flights_over_that_of_noise(spread: float) -> None:
    """A mean of F values with variance s²: its variance is s²/F by their scatter, 1/(rows F) by noise."""
    values = 0.5 + spread * np.array([-1.0, 0.0, 1.0, 2.0, -2.0])
    whole = NormalEquations(product=np.full((1, 1), ROWS * values.size), gradient=np.array([ROWS * values.sum()]))
    result = make_support(whole, of_flights(values))
    assert result.overdispersion == pytest.approx(ROWS * values.var(ddof=1), rel=2e-3, abs=2e-3)
    assert result.wald == pytest.approx(ROWS * values.size * 0.5**2, rel=2e-3)


def test_a_distance_counts_over_the_larger_of_two_variances() -> None:
    """Log odds of 90 of which 100 are the distance's: over four times the variance it is 25; flights never add to it."""
    one = Support(log_odds=90.0, wald=200.0, overdispersion=4.0, size=1)
    assert one.robust_log_odds == pytest.approx(15.0)
    assert replace(one, overdispersion=0.2).robust_log_odds == 90.0
    assert one.is_supported
    assert not replace(one, overdispersion=20.0).is_supported


@pytest.mark.parametrize(("rows", "shown"), [(ROWS, True), (0.9, False), (0.0, False)])
def test_a_parameter_is_shown_where_flights_tell_it_better_than_by_its_scale(rows: float, shown: bool) -> None:
    """A mean of ``rows`` rows of a standard deviation of one scale; what is far from neutral shows no better for it."""
    whole = NormalEquations(product=np.full((1, 1), rows), gradient=np.array([50.0 * rows]))
    assert make_support(whole, of_flights(np.full(4, 50.0))).shown is shown


def library(values: Array) -> Library:
    """Return candidates of one parameter each, orthogonal to each other, for which flights ask for values (F, K); the
    tolerance behind them does nothing."""
    flights, width = values.shape
    names = ("rotor_drag", "quadratic_drag", "constant_wind")[:width]
    product = np.pad(
        np.broadcast_to(ROWS * np.eye(width), (flights, 1, width, width)), ((0, 0), (0, 0), (0, 1), (0, 1))
    )
    return Library(
        candidates=tuple(
            Candidate(name=name, named=False, columns=np.array([k]), low=np.array([-np.inf]), high=np.array([np.inf]))
            for k, name in enumerate(names)
        ),
        moments=Moments(
            count=np.full(flights, ROWS),
            square=np.full((flights, 1), ROWS),
            gradient=np.pad(ROWS * values[:, None, :], ((0, 0), (0, 0), (0, 1))),
            product=product,
            flight=np.arange(flights),
        ),
        tolerances=np.array([width], dtype=np.int64),
        weight=np.ones(1),
    )


def test_what_flights_contradict_goes_and_the_rest_stays() -> None:
    """Both means are 0.3 and highly probable by noise; of one the flights ask for values between -3 and 3."""
    agreed, contradicted = np.full(6, 0.3), 0.3 + np.array([3.0, -3.0, 2.0, -2.0, 1.0, -1.0])
    about = library(np.column_stack((agreed, contradicted)))
    sets = search_sets(make_candidates(about), make_normal_equations(about))
    guard = Guard(about, sets)
    assert sets.most_probable_set == (0, 1)
    assert guard.drop_unsupported((0, 1)) == (0,)
    assert guard.support((0, 1))[1].log_odds > 50.0


@pytest.mark.parametrize(("flights", "parts"), [(1, 4), (2, 2), (3, 2), (4, 1), (7, 1)])
def test_few_flights_are_taken_in_parts(flights: int, parts: int) -> None:
    assert num_parts_per_flight(flights) == parts
