"""Which sets are fitted on the way to the most probable one, with fits that are given."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from aerial_gym.sim2real.identify.candidates.library import Candidate
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.least_squares.gauss_newton import MOST_TO_PROMISE
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.candidate_view import FAR_BEHIND, CandidateView, occam_window
from aerial_gym.sim2real.identify.selection.set_search import MOST_TURNS, SetSearch
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.set_fits import FitStub, make_fit

NAMES = ("com_offset", "rotor_drag", "quadratic_drag", "constant_wind")


class Singles(FitStub):
    """Fits of one effect of ``NAMES`` each."""

    def fit_set(self, _library: object, _sets: object, model: Model, *_: object) -> EffectSetFit:
        """Return the set."""
        return self.fit(tuple(NAMES[k] for k in model), (), self.start(model))

    def start(self, model: Model) -> Any:
        """Return the effects of a set."""
        return SimpleNamespace(effects={NAMES[k]: None for k in model})


def make_view(promised: dict[Model, float], *sets: EffectSetFit) -> CandidateView:
    """Return a view about the first of the sets, a centre of mass, with what the linear model has of all."""
    none, start = np.zeros(0, dtype=np.int64), np.zeros(3)
    candidates = [
        Candidate(name=name, named=k == 0, columns=none, low=start, high=start, start=start)
        for k, name in enumerate(NAMES)
    ]
    linear = SimpleNamespace(
        log_posterior=promised,
        log_posteriors=lambda models: np.array([promised[model] for model in models]),
        candidates=SimpleNamespace(structures=frozenset()),
    )
    return CandidateView(
        present=sets[0],
        fits={sets[0].label: sets[0]},
        own={sets[0].label: cast("Any", None)},
        fresh=set(),
        fitter=Singles(*sets),
        library=cast("Any", SimpleNamespace(candidates=candidates)),
        structures=[],
        sets=cast("Any", linear),
        guard=cast("Any", SimpleNamespace(drop_unsupported=lambda model: model)),
    )


@pytest.mark.parametrize(("times", "tried"), [(0.99, True), (1.01, False)])
def test_a_set_is_not_fitted_that_the_linear_model_has_further_behind_than_a_fit_can_mend(
    times: float, tried: bool
) -> None:
    best, drag = make_fit("com_offset", overdispersion=4.0), make_fit("rotor_drag", log=-1e3)
    behind = times * MOST_TO_PROMISE * FAR_BEHIND * occam_window(best)
    view = make_view({(0,): -7.0, (1,): -7.0 - behind}, best, drag)
    view.fit((1,))
    assert (drag.label in view.fits) == tried


def test_the_best_other_effect_is_fitted_however_far_and_whether_or_not_it_holds_where_it_is_linear() -> None:
    best, drag = make_fit("com_offset"), make_fit("rotor_drag", log=-1e6)
    view = make_view({(0,): 0.0, (1,): -1e6, (2,): -2e6, (3,): -3e6}, best, drag)
    view.guard.drop_unsupported = lambda _model: ()
    SetSearch.fit_rivals(cast("Any", None), view)
    assert set(view.fits) == {best.label}
    SetSearch.fit_nearest(cast("Any", None), view)
    assert set(view.fits) == {best.label, drag.label}


@pytest.mark.parametrize(("ahead", "tried"), [(1.0, True), (-1.0, False)])
def test_of_a_set_that_cannot_come_near_the_best_no_part_is_fitted(ahead: float, tried: bool) -> None:
    """It does not hold; what it could have at most is just beside odds of 1e-4 against the best."""
    best, drag = make_fit("com_offset", overdispersion=4.0), make_fit("rotor_drag", log=-1e3)
    least = best.log_posterior - FAR_BEHIND * occam_window(best)
    both = make_fit("rotor_drag", "motor_tilt", log=-1e3, odds={"motor_tilt": -1.0})
    empty = cast("Any", None)
    view = CandidateView(
        present=best,
        fits={best.label: best},
        own={},
        fresh=set(),
        fitter=FitStub(drag),
        library=empty,
        structures=[],
        sets=empty,
        guard=empty,
    )
    view.add(replace(both, most=least + ahead))
    assert both.label in view.fits
    assert (drag.label in view.fits) == tried


class SearchStub(SetSearch):
    """Search that fits nothing, records its moves and takes given weights."""

    def __init__(self, *weights: float) -> None:
        self.declared, self.given, self.gone = ModelParams(), list(weights), list[Any]()

    def residual_weights(self, view: CandidateView) -> Weighting:
        """Return the next of the given weights; the last one repeats."""
        weight = self.given.pop(0) if len(self.given) > 1 else self.given[0]
        return Weighting(variance=np.array([1.0 / weight]), effective=np.ones(1))

    def start(self) -> CandidateView:
        """Return the first view of the search."""
        return self.start_view(self.declared, (), (), self.residual_weights(cast("Any", None)))

    def start_view(
        self, params: ModelParams, effects: Any, structures: Any, weights: Weighting, *_: Any
    ) -> CandidateView:
        """Return a view with the given weights, and record the start."""
        self.gone.append("start")
        fitter = SimpleNamespace(weights=weights)
        return cast("Any", SimpleNamespace(present=make_fit(), fitter=fitter, let_go=lambda: None))

    def climb(self, ways: Any) -> None:
        """Stay."""
        self.gone.append("all" if self.fit_rivals in ways else "likely")


@pytest.mark.parametrize(
    ("weights", "gone"),
    [
        ((1.0, 1.1), ["start", "likely", "all"]),
        ((1.0, 2.0, 2.1), ["start", "likely", "start", "likely", "all"]),
        ((1.0, 1.1, 2.0, 2.1), ["start", "likely", "all", "start", "all"]),
        (tuple(2.0**k for k in range(9)), ["start", *["likely", "start"] * 2, "likely", *["all", "start"] * 2, "all"]),
    ],
)
def test_rivals_are_fitted_once_weights_have_settled(weights: tuple[float, ...], gone: list[str]) -> None:
    climber = SearchStub(*weights)
    climber.run()
    assert climber.gone == gone


@pytest.mark.parametrize(
    ("deviations", "turns"),
    [
        ((0.0, 0.4), 1),
        ((0.0, 1.4, 1.8), 2),
        ((0.0, 1.0, 0.4, 1.0, 0.4, 1.0), MOST_TURNS),
        ((0.0, 1.0, 0.4, 2.0), 2),
        ((0.0, 1.4, None), 2),
    ],
    ids=["stays", "moves once", "never stays", "leads away", "goes nowhere"],
)
def test_a_set_is_fitted_about_itself_until_its_deviations_stay(
    deviations: tuple[float | None, ...], turns: int
) -> None:
    fits = [replace(make_fit(), deviation=np.zeros(0) if one is None else np.array([one, 0.2])) for one in deviations]
    number, about, fitters = 0, list[ModelParams](), list[Any]()

    def refit(before: EffectSetFit, _: object) -> EffectSetFit:
        nonlocal number
        assert before is fits[number]
        number += 1
        return fits[number]

    def linear_fitter(params: ModelParams, _: object) -> Any:
        about.append(params)
        fitters.append(SimpleNamespace(refit=refit, forget_nuisance_sums=lambda: None, weights=None))
        return fitters[-1]

    climber, first = SimpleNamespace(fitter_at_model=linear_fitter), linear_fitter(ModelParams(), None)
    result, fitter = SetSearch.relinearise(cast("Any", climber), fits[0], first)
    assert result is fits[turns]
    assert fitter is fitters[turns]
    for params, one in zip(about[1:], fits[:number], strict=True):
        np.testing.assert_array_equal(params.deviation, one.deviation)


def test_a_set_that_does_not_hold_under_new_weights_is_left_for_what_holds_of_it() -> None:
    both = make_fit("rotor_drag", "motor_tilt", odds={"motor_tilt": -1.0})
    drag = make_fit("rotor_drag", log=-3.0)
    climber = SimpleNamespace(
        declared=ModelParams(),
        fitter_at_model=lambda *_: FitStub(both, drag, make_fit(log=-50.0)),
        candidate_view=lambda present, own, fits, _: (present, list(own), list(fits)),
    )
    result = SetSearch.start_view(cast("Any", climber), both.params, both.effects, (), cast("Any", None))
    assert result == (drag, [drag.label], [()])
