"""Fitted sets of effects: how probable each is, what speaks for an effect, and what a robot file can hold."""

from dataclasses import replace
from math import exp
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.candidates.library import Candidate, Library
from aerial_gym.sim2real.identify.evidence.fitting import laws_in_place
from aerial_gym.sim2real.identify.evidence.guard import (
    Guard,
    Support,
    make_candidates,
    make_normal_equations,
    supports_of_candidates,
)
from aerial_gym.sim2real.identify.evidence.laplace import NormalEquations, posterior
from aerial_gym.sim2real.identify.evidence.relinearise import refit_from_starts
from aerial_gym.sim2real.identify.evidence.search import SetPosterior, search_sets
from aerial_gym.sim2real.identify.least_squares.moments import Moments
from aerial_gym.sim2real.identify.selection.choose import inclusion_probabilities, set_probabilities
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.identify.evidence.linear import candidates, normal
from tests.unit.sim2real.set_fits import PLACE, FitStub, make_fit


@pytest.mark.parametrize("overdispersion", [1.0, 4.0])
def test_odds_are_those_of_evidence_over_the_overdispersion(overdispersion: float) -> None:
    """Two sets 3 apart: odds of e³, and of e^(3/4) where parameters scatter twice as far as by noise."""
    sets = [make_fit("rotor_drag", log=-100.0), make_fit("quadratic_drag", log=-103.0)]
    result = set_probabilities(sets, overdispersion=overdispersion)
    assert list(result) == [("rotor_drag",), ("quadratic_drag",)]
    assert result["rotor_drag",] / result["quadratic_drag",] == pytest.approx(exp(3.0 / overdispersion))
    assert sum(result.values()) == pytest.approx(1.0)


def test_the_same_effects_beside_other_structures_are_one_set() -> None:
    sets = [
        make_fit("payload_mass", "rotor_drag", log=-5.0),
        make_fit("rotor_drag", "payload_mass", log=-5.0, structures=(PLACE,)),
        make_fit("rotor_drag", log=-5.0),
    ]
    result = set_probabilities(sets, overdispersion=1.0)
    assert result == {("payload_mass", "rotor_drag"): pytest.approx(2 / 3), ("rotor_drag",): pytest.approx(1 / 3)}
    assert inclusion_probabilities(result) == {"rotor_drag": pytest.approx(1.0), "payload_mass": pytest.approx(2 / 3)}


def test_not_the_weakest_effect_goes_but_the_one_without_which_the_rest_holds() -> None:
    both = make_fit("rotor_drag", "motor_tilt", odds={"rotor_drag": -2.0, "motor_tilt": -1.0})
    tilt, drag = make_fit("motor_tilt", log=-3.0, odds={"motor_tilt": -1.0}), make_fit("rotor_drag", log=-5.0)
    assert FitStub(tilt, drag, make_fit(log=-9.0)).drop_unsupported(both) is drag


def test_where_even_nothing_is_no_fit_the_search_ends() -> None:
    empty = make_fit(log=float("-inf"))
    assert FitStub(empty).drop_unsupported(empty) is empty
    assert FitStub(empty).drop_unsupported(make_fit("rotor_drag", odds={"rotor_drag": -1.0})) is empty


def test_a_fit_that_no_longer_holds_from_its_most_probable_parameters_is_not_taken() -> None:
    drag = make_fit("rotor_drag", log=-2.0)
    beside = make_fit("rotor_drag", log=-1.9, odds={"rotor_drag": -0.1})
    assert FitStub(beside).set_for_robot_file(drag) is drag


def test_what_does_not_hold_goes_until_all_that_is_left_holds() -> None:
    odds = {"payload_mass": -2.0, "constant_wind": -1.0}
    whole = make_fit("rotor_drag", "payload_mass", "constant_wind", odds=odds)
    pair, drag = make_fit("rotor_drag", "constant_wind", odds=odds), make_fit("rotor_drag")
    assert FitStub(pair, drag).drop_unsupported(whole) is drag
    assert FitStub().drop_unsupported(drag) is drag
    assert FitStub(pair, drag).set_for_robot_file(whole) is drag


def test_a_robot_file_keeps_an_effect_whose_parameter_ends_at_a_bound() -> None:
    """A drag at the largest number that is possible."""
    both = make_fit("rotor_drag", "com_offset", params={"rotor_drag": [10.0, 0.0, 0.3], "com_offset": [0.0, 0.0, 0.0]})
    assert FitStub(both).set_for_robot_file(both) is both


@pytest.mark.parametrize(
    ("name", "start", "count"), [("weak_motor", [2.0, 1.0], 1), ("slung_payload", [0.0, 1.0, 0.01], 2)]
)
def test_an_effect_on_one_rotor_is_fitted_from_one_start_and_a_pendulum_from_two(name, start, count) -> None:
    size = len(start) - (name == "weak_motor")
    one = Candidate(
        name=name, named=False, columns=np.arange(size), low=np.full(size, -np.inf), high=np.full(size, np.inf),
        start=np.array(start),
    )  # fmt: skip
    moments = cast("Moments", None)
    library = Library(candidates=(one,), moments=moments, weight=np.ones(1), tolerances=np.arange(0))
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(50, size))
    sums = normal(columns, columns @ np.full(size, 0.02) + 1e-3 * rng.normal(size=50))
    sets = SetPosterior(candidates=candidates(size, names=(name,)), normal=sums)
    assert len(FitStub().start_models_of_fit(library, sets, (0,))) == count


def test_a_set_with_a_load_is_fitted_from_every_length_and_the_best_fit_counts() -> None:
    """Each length has a maximum of its own. Beside a load, an effect on one rotor keeps its rotor and its values."""
    tried = list[tuple[float, float]]()

    class LocalMaxima(FitStub):
        def fit(self, effects, structures, start, *_, **_compared):
            length, rotor = start.effects["slung_payload"][1], start.effects["weak_motor"][0]
            tried.append((length, rotor))
            return make_fit(*effects, log=-abs(length - 0.8), params={"slung_payload": [0.05, length, 0.01]})

    params = {"slung_payload": [0.06, 0.7, 0.04], "weak_motor": [3.0, 0.9]}
    stuck = make_fit("slung_payload", "weak_motor", log=-10.0, params=params)
    best = refit_from_starts(stuck, LocalMaxima())
    assert best.params.effects["slung_payload"][1] == 0.8
    assert [length for length, _ in tried] == [start[1] for start in EFFECTS.get("slung_payload").starts(ROBOT)]
    assert tried[0][1] == 3.0
    first = make_fit("slung_payload", "weak_motor", log=1.0, params=params)
    assert refit_from_starts(first, LocalMaxima()) is first
    drag = make_fit("rotor_drag")
    assert refit_from_starts(drag, FitStub()) is drag


Array = NDArray[np.float64]

ROWS = 400.0  # Of each flight, each with noise of one


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
    assert one.log_odds_with_overdispersion == pytest.approx(15.0)
    assert replace(one, overdispersion=0.2).log_odds_with_overdispersion == 90.0
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


@pytest.mark.parametrize(("law", "alternatives"), [
    ("rotor_drag", ("rotor_drag_of_thrust",)), ("rotor_drag_of_thrust", ("rotor_drag",)),
    ("quadratic_drag_of_axes", ("quadratic_drag",)), ("ground_effect", ()), ("ground_effect_curve", ("ground_effect",)),
])  # fmt: skip
def test_laws_take_the_place_of_others_of_the_same_cause(law: str, alternatives: tuple[str, ...]) -> None:
    """A curve is a candidate by itself, so that it is not tried in place of the formula."""
    assert laws_in_place(law) == alternatives
