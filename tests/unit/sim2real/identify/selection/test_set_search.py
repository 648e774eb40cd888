"""The search among sets of effects, and gains on flights left out from squares that are written down."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from aerial_gym.sim2real.identify.candidates.library import Candidate, Library
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Fitter
from aerial_gym.sim2real.identify.evidence.guard import Guard
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.evidence.search import SetPosterior
from aerial_gym.sim2real.identify.learned import CrossValidation
from aerial_gym.sim2real.identify.least_squares.gauss_newton import MOST_TO_PROMISE, StopRule
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.candidate_view import FAR_BEHIND, CandidateView, occam_window, rival_sets
from aerial_gym.sim2real.identify.selection.set_search import SetSearch
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.identify.evidence.linear import candidates as linear_candidates
from tests.unit.sim2real.set_fits import FitStub, make_fit, make_left_out

NAMES = ("com_offset", "rotor_drag", "quadratic_drag", "constant_wind")


class Singles(FitStub):
    def fit_set(self, _library: object, _sets: object, model: Model, *_: object) -> EffectSetFit:
        effects = tuple(NAMES[k] for k in model)
        return self.fit(effects, (), ModelParams(effects=dict.fromkeys(effects, np.zeros(0))))


class GuardStub(Guard):
    def __init__(self, *, keeps: bool = True) -> None:
        self.keeps = keeps

    def drop_unsupported(self, model: Model) -> Model:
        return model if self.keeps else ()


def make_view(
    promised: dict[Model, float], *sets: EffectSetFit, fitter: Fitter | None = None, keeps: bool = True
) -> CandidateView:
    """Return a view about the first of the sets, a centre of mass, with what the linear model has of all."""
    none, start = np.zeros(0, dtype=np.int64), np.zeros(3)
    candidates = tuple(
        Candidate(name=name, named=k == 0, columns=none, low=start, high=start, start=start)
        for k, name in enumerate(NAMES)
    )
    label = sets[0].label
    return CandidateView(
        present=sets[0], fits={label: sets[0]}, own={label: fitter} if fitter is None else {}, fresh=set(),
        fitter=fitter or Singles(*sets),
        library=Library(candidates=candidates, moments=None, weight=np.ones(1), tolerances=none), structures=[],
        sets=SetPosterior(candidates=linear_candidates(*[0] * len(NAMES)), normal=None, log_posterior=promised),
        guard=GuardStub(keeps=keeps),
    )  # fmt: skip


@pytest.mark.parametrize(("times", "tried"), [(0.99, True), (1.01, False)])
def test_a_set_is_not_fitted_that_the_linear_model_has_further_behind_than_a_fit_can_mend(times, tried) -> None:
    best, drag = make_fit("com_offset", overdispersion=4.0), make_fit("rotor_drag", log=-1e3)
    behind = times * MOST_TO_PROMISE * FAR_BEHIND * occam_window(best)
    view = make_view({(0,): -7.0, (1,): -7.0 - behind}, best, drag)
    view.fit_if_promising((1,))
    assert (drag.label in view.fits) == tried


def test_the_best_other_effect_is_fitted_however_far_and_whether_or_not_it_holds_where_it_is_linear() -> None:
    best, drag = make_fit("com_offset"), make_fit("rotor_drag", log=-1e6)
    promised = {(0,): 0.0, (1,): -1e6, (2,): -2e6, (3,): -3e6}
    view, climber = make_view(promised, best, drag, keeps=False), SearchStub()
    climber.fit_rival_sets(view)
    assert set(view.fits) == {best.label}
    climber.fit_nearest_rivals(view)
    assert set(view.fits) == {best.label, drag.label}


@pytest.mark.parametrize(("moved", "log"), [(0.6, 5.0), (0.4, -1e3)])
def test_near_rivals_are_compared_about_themselves_if_their_deviations_move(moved: float, log: float) -> None:
    """About the present set both lie far behind; the drag is not distinct from the nearest rival, the wind is."""
    best = replace(make_fit("com_offset"), deviation=np.zeros(2))
    rivals = [replace(make_fit(name, log=-1e3), deviation=np.array([0.0, moved])) for name in NAMES[1:]]
    view, climber = make_view({(0,): 0.0, (1,): -102.0, (2,): -100.0, (3,): -104.0}, best, *rivals), SearchStub()
    climber.refit_about_own_model = lambda fitted, about, *_: (replace(fitted, log_posterior=5.0), about)
    climber.fit_nearest_rivals(view)
    drag, quadratic, wind = (one.label for one in rivals)
    assert view.fits[drag].log_posterior == view.fits[quadratic].log_posterior == log
    assert wind not in view.fits


def test_another_rotor_takes_the_place_of_the_rotor_of_an_effect_and_of_no_other_effect() -> None:
    weak, drag, other = "weak_motor", "rotor_drag", "quadratic_drag"
    promised = {model: 0.0 for size in (1, 2) for model in combinations(range(4), size)}
    view = make_view(promised, make_fit(weak, drag, params={weak: (1.0, 0.9)}))
    rotors = zip(view.library.candidates, (weak, weak, drag, other), strict=True)
    candidates = tuple(replace(one, name=name, named=name == drag) for one, name in rotors)
    candidates = (replace(candidates[0], named=True), *candidates[1:])
    view = replace(view, library=replace(view.library, candidates=candidates))
    assert [set(models) for models in rival_sets(view)] == [{(1, 2), (2, 3)}, {(0, 3)}]


@pytest.mark.parametrize(("ahead", "tried"), [(1.0, True), (-1.0, False)])
def test_of_a_set_that_cannot_come_near_the_best_no_part_is_fitted(ahead: float, tried: bool) -> None:
    """It does not hold; what it could have at most is just beside odds of 1e-4 against the best."""
    best, drag = make_fit("com_offset", overdispersion=4.0), make_fit("rotor_drag", log=-1e3)
    least = best.log_posterior - FAR_BEHIND * occam_window(best)
    both = make_fit("rotor_drag", "motor_tilt", log=-1e3, odds={"motor_tilt": -1.0})
    view = make_view({}, best, fitter=FitStub(drag))
    view.add_fit(replace(both, most=least + ahead))
    assert both.label in view.fits
    assert (drag.label in view.fits) == tried


class SearchStub(SetSearch):
    """Search that has no flights."""

    def __init__(self) -> None:
        self.declared = ModelParams()


@pytest.mark.parametrize("reached", [True, False])
def test_derivatives_are_computed_anew_only_for_rivals_within_reach(
    monkeypatch: pytest.MonkeyPatch, reached: bool
) -> None:
    """They are until it cannot come within Occam's window of the present set."""
    limits, rival, present = [], make_fit("rotor_drag", log=-20.0), make_fit("com_offset", log=-10.0)

    def refit(fitted: EffectSetFit, about: Fitter, *_: object, **settings: float) -> tuple[EffectSetFit, Fitter, bool]:
        limits.append((settings.get("secant", False), settings["least"]))
        return fitted, about, reached

    monkeypatch.setattr("aerial_gym.sim2real.identify.evidence.relinearise.refit_until_settled", refit)
    SearchStub().refit_about_own_model(rival, FitStub(), present, StopRule(least=-30.0))
    assert limits == [(True, -30.0), (False, -10.0 - occam_window(present))][: 1 + reached]


@pytest.mark.parametrize(("moved", "refitted"), [(0.6, True), (0.4, False)])
def test_a_set_without_an_effect_whose_deviations_moved_is_compared_about_itself(moved: float, refitted: bool) -> None:
    """However far behind it is about the present set: else effects are named that the delays of sensors explain as well."""
    best = replace(make_fit("com_offset"), deviation=np.zeros(2))
    less = replace(make_fit(log=-1e3), deviation=np.array([0.0, moved]))
    view, climber = make_view({(0,): 0.0, (): -1e6}, best, less), SearchStub()
    climber.refit_about_own_model = lambda fitted, about, *_: (replace(fitted, log_posterior=5.0), about)
    climber.refit_moved_sets(view)
    assert less.label in view.fits
    assert (less.label in view.own) == refitted
    assert view.best_fit.effects == (() if refitted else best.effects)


def test_a_smaller_set_that_lacks_support_is_left_for_its_part_about_itself() -> None:
    """Without the offset the drag lacks support, so that the empty set is compared about itself as well."""
    best = replace(make_fit("com_offset", "rotor_drag"), deviation=np.zeros(2))
    less = replace(make_fit("rotor_drag", log=-1e3, odds={"rotor_drag": -1.0}), deviation=np.array([0.0, 0.6]))
    empty = make_fit(log=-2e3)
    view, climber = make_view({(0, 1): 0.0, (0,): -1e6, (1,): -1e6}, best, less, empty), SearchStub()
    candidates = tuple(replace(one, named=k < 2) for k, one in enumerate(view.library.candidates))
    view = replace(view, library=replace(view.library, candidates=candidates))
    climber.refit_about_own_model = lambda fitted, about, *_: (replace(fitted, log_posterior=5.0), about)
    climber.refit_moved_sets(view)
    assert {less.label, empty.label} <= view.own.keys()
    assert view.best_fit.effects == ()


def test_a_fit_without_effects_that_fails_is_left_as_it_is() -> None:
    """It has no part; it was divided into parts as any set without support."""
    best, failed = make_fit("com_offset"), replace(make_fit(), log_posterior=-np.inf, most=np.inf)
    view = make_view({(0,): 0.0}, best)
    view.add_relinearised_fit(failed, FitStub())
    assert not failed.is_supported
    assert view.best_fit is best


def test_a_set_that_does_not_hold_under_new_weights_is_left_for_what_holds_of_it() -> None:
    both = make_fit("rotor_drag", "motor_tilt", odds={"motor_tilt": -1.0})
    drag = make_fit("rotor_drag", log=-3.0)
    climber = SearchStub()
    climber.fitter_at_model = lambda *_: FitStub(both, drag, make_fit(log=-50.0))
    climber.make_candidate_view = lambda present, own, fits, _: (present, list(own), list(fits))
    result = SetSearch.view_of_supported_set(climber, both.params, both.effects, (), None)
    assert result == (drag, [drag.label], [()])


BLOCKS, FLIGHTS = 8, 4


def left_out() -> CrossValidation:
    """Return four flights of eight blocks of 60 rows, two channels, nothing tolerated."""
    blocks = BLOCKS * FLIGHTS
    channels = tuple(Channel(kind="specific_force", axis=axis) for axis in "xy")
    weights = Weighting(variance=np.ones(2), effective=np.full(2, 0.5))
    return make_left_out(weights, np.full(blocks, 60.0), np.repeat(np.arange(FLIGHTS), BLOCKS), channels)


def squares(*factors: float) -> np.ndarray:
    """Return squares that are ``factors`` of one in each flight, in the first channel."""
    result = np.ones((BLOCKS * FLIGHTS, 2))
    result[:, 0] = np.repeat(factors, BLOCKS)
    return result


@pytest.mark.parametrize(("factors", "share"), [
    ((0.2, 0.2, 0.2, 0.2), 1.0),
    ((0.2, 0.2, 1.01, 1.01), 1.0),  # still air shows no drag: a change of 1 % says nothing
    ((0.2, 0.2, 1.2, 1.2), 0.5),
    ((0.2, 1.01, 1.01, 1.01), 0.25),  # one flight alone is no evidence
])  # fmt: skip
def test_a_flight_that_does_not_show_an_effect_does_not_speak_against_it(factors, share) -> None:
    assert left_out().gain(squares(1.0, 1.0, 1.0, 1.0), squares(*factors)).flights_better == share


def test_the_fall_of_a_channel_is_that_of_its_rms() -> None:
    gain = left_out().gain(squares(1.0, 1.0, 1.0, 1.0), squares(0.25, 0.25, 0.25, 0.25))
    assert gain.falls == pytest.approx((0.5, 0.0))


@pytest.mark.parametrize(("gained", "lost", "harmful"), [
    (0.25, 1.02, False),  # 1 % of the rms is no harm
    (0.25, 1.12, False),  # 4 log 2 are gained for each log 1.12 that is lost
    (0.25, 1.2, True),  # more than a tenth of the gain
    (0.9, 1.12, True),
    (1.0, 1.12, True),
])  # fmt: skip
def test_what_a_channel_loses_is_harm_unless_others_gain_ten_times_as_much(gained, lost, harmful) -> None:
    more = squares(*[gained] * FLIGHTS)
    more[:, 1] = lost
    judge = left_out()
    result = judge.gain(squares(*[1.0] * FLIGHTS), more)
    assert result.worse == (False, harmful)
    assert result.harmed == (0.0, float(harmful))
    assert bool(judge.findings_on_harm(result)) is harmful


@pytest.mark.parametrize(("factors", "tolerated", "said"), [
    ((0.2, 0.2, 0.2, 0.2), 0.0, []),
    ((0.2, 0.2, 0.2, 0.2), 2.0, [("gain_small", 0.553)]),
    ((0.2, 0.2, 1.2, 1.2), 0.0, [("few_flights_better", 0.5), ("channel_worse_in_flights", 0.5)]),
    ((1.0, 1.0, 1.0, 1.0), 0.0, [("gain_by_chance", None), ("few_flights_better", 0.0), ("gain_small", 0.0)]),
    (
        (1.3, 1.3, 1.3, 1.3),
        0.0,
        [("gain_by_chance", None), ("few_flights_better", 0.0), ("gain_small", 0.0), ("channel_worse", 0.14)],
    ),
])  # fmt: skip
def test_why_a_gain_on_flights_left_out_does_not_count(factors: tuple, tolerated: float, said: list[tuple]) -> None:
    """A fall of the mean square to a fifth is one of the rms by 1 - sqrt(0.2); a rise to 1.3 one by sqrt(1.3) - 1."""
    judge = replace(left_out(), tolerated=np.full(2, tolerated))
    result = judge.objections(judge.gain(squares(1.0, 1.0, 1.0, 1.0), squares(*factors)))
    assert [one.code for one in result] == [code for code, _ in said]
    shares = [(one.values["share"], share) for one, (_, share) in zip(result, said, strict=True) if share is not None]
    assert all(share == pytest.approx(expected, abs=1e-3) for share, expected in shares)
