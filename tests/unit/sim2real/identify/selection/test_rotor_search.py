"""The proven set by fits that are given: effects of one rotor that stand in for each other."""

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.candidates.library import Candidate
from aerial_gym.sim2real.identify.selection.rotor_search import (
    PossibleEffect,
    RotorSearch,
    is_proven,
    odds_against_parts,
    variance_between_sets,
)
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.set_fits import PLACE, FitStub, make_fit

POOL = ("weak_motor", "motor_tilt")
STARTS = [(name, np.array(start, float)) for name in POOL for start in EFFECTS.get(name).starts(ROBOT)]


class RotorFits(FitStub):
    """Fits whose effects have odds by their label; beside another effect only the larger ones hold."""

    def __init__(self, odds: Mapping[str, float]) -> None:
        super().__init__()
        self.odds = odds

    def fit(self, effects, structures, start, *_, **_compared):
        odds = {name: self.odds.get(f"{name} {start.effects[name][0]:.0f}", -9.0) for name in effects}
        odds = {name: value if value == max(odds.values()) else -9.0 for name, value in odds.items()}
        return make_fit(
            *effects,
            log=sum(odds.values()),
            odds=odds,
            params={name: start.effects[name].tolist() for name in effects},
            structures=tuple(structures),
        )


def rotor_search(odds: Mapping[str, float], linear: Mapping[str, float] | None = None) -> RotorSearch:
    """Return the search of a set whose effects have these odds in a fit, and in the linear model."""
    fitter, known = RotorFits(odds), linear or odds
    candidates = [
        Candidate(name=name, named=False, columns=np.zeros(1, int), low=np.zeros(1), high=np.zeros(1), start=start)
        for name, start in STARTS
    ]

    def support(model: tuple[int, ...]):
        labels = [(candidates[k].name, candidates[k].start) for k in model]
        values = {k: known.get(f"{name} {start[0]:.0f}", -9.0) for k, (name, start) in zip(model, labels, strict=True)}
        return {k: make_fit("weak_motor", odds={"weak_motor": v}).support["weak_motor"] for k, v in values.items()}

    present = make_fit(*POOL, odds=dict.fromkeys(POOL, 4.0), params={"weak_motor": (4.0, 1.1), "motor_tilt": (1, 0, 0)})
    guard, library = SimpleNamespace(support=support), SimpleNamespace(candidates=candidates)
    view = SimpleNamespace(present=present, fitter=fitter, guard=guard, library=library)
    return RotorSearch(view, frozenset(POOL))  # type: ignore[arg-type]


def test_an_effect_that_is_unproven_beside_others_is_named_on_the_rotor_that_shows_it_without_them() -> None:
    """The most probable set has rotor 4 beside a tilted rotor 1; neither is proven. Alone, rotor 1 is."""
    case = rotor_search({"weak_motor 1": 11.6, "weak_motor 3": -3.2, "motor_tilt 2": 4.3})
    named = case.best_set(make_fit())
    assert [*map(float, named.params.effects["weak_motor"][:1])] == [1.0]
    assert named.effects == ("weak_motor",)
    assert case.ties(named) == {}


def test_an_effect_of_one_rotor_gives_way_to_one_with_larger_odds() -> None:
    case = rotor_search({"weak_motor 4": 12.0, "motor_tilt 2": 7.0})
    tilted = make_fit("motor_tilt", log=7.0, odds={"motor_tilt": 7.0}, params={"motor_tilt": (2.0, 0.0, 0.0)})
    named = case.best_set(tilted)
    assert named.params.effects["weak_motor"][0] == 4.0
    assert "motor_tilt 2" not in named.label


@pytest.mark.parametrize(("other", "ties"), [(9.1, ("weak_motor 3",)), (8.9, None)])
def test_rotors_that_flights_do_not_distinguish_are_tied(other: float, ties: tuple[str, ...] | None) -> None:
    case = rotor_search({"weak_motor 1": 12.0, "weak_motor 3": other})
    assert case.ties(case.best_set(make_fit())) == ({} if ties is None else {"weak_motor": ties})


@pytest.mark.parametrize(
    ("ahead", "scatter", "label", "ties"),
    [
        (75.0, 20.0, "weak_motor 3", {}),
        (75.0, 30.0, "weak_motor 3", {"weak_motor": ("weak_motor 1",)}),
        (-75.0, 30.0, "weak_motor 1", {"weak_motor": ("weak_motor 3",)}),
        (-75.0, 20.0, "weak_motor 1", {}),
    ],
)
def test_rotors_are_compared_by_evidence_over_the_larger_overdispersion(
    ahead: float, scatter: float, label: str, ties: dict
) -> None:
    """Robust odds of 12 against 8 are no reason: the two overdispersions, of which one is 1, differ by chance."""
    case = rotor_search({"weak_motor 1": 12.0, "weak_motor 3": 8.0})
    fit = case.view.fitter.fit

    def fit_with_evidence(effects, structures, start, *_, **_compared):
        fitted, third = fit(effects, structures, start), [v[0] for v in start.effects.values()] == [3.0]
        own = scatter if third else 1.0
        support = {name: replace(one, overdispersion=own) for name, one in fitted.support.items()}
        return replace(fitted, log_posterior=ahead if third else 0.0, support=support)

    case.view.fitter.fit = fit_with_evidence
    named = case.best_set(make_fit())
    assert named.label == (label,)
    assert case.ties(named) == ties


def test_a_rotor_that_only_the_linear_model_shows_is_not_named() -> None:
    assert rotor_search({"weak_motor 1": 4.5}, {"weak_motor 1": 20.0}).best_set(make_fit()).effects == ()
    assert rotor_search({"weak_motor 1": 20.0}, {"weak_motor 1": -0.1}).best_set(make_fit()).effects == ()
    empty = make_fit()
    assert is_proven(empty, empty, {})


@pytest.mark.parametrize(
    ("behind", "structures", "proven"), [(10.0, (), True), (2.0, (), False), (2.0, (PLACE,), True)]
)
def test_an_effect_that_tolerances_can_replace_is_not_proven(behind: float, structures: tuple, proven: bool) -> None:
    """Derivatives give odds of 70; the set without the effect, fitted itself, is less behind.

    A set with an unknown cause in place of the effect is no part.
    """
    present = make_fit("motor_asymmetry", odds={"motor_asymmetry": 70.0}, log=-100.0)
    rival = make_fit("battery_sag", log=-100.5)
    fits = [present, rival, make_fit(log=-100.0 - behind, structures=structures)]
    assert is_proven(present, present, odds_against_parts(present, fits)) is proven


def test_the_interval_covers_the_values_beside_effects_that_may_act() -> None:
    """A weak rotor with even odds moves the thrust from 1.16 to 1.18: half of the squared change is its variance."""
    alone, beside = (make_fit("thrust_coefficient", params={"thrust_coefficient": (value,)}) for value in (1.16, 1.18))
    possible = PossibleEffect("weak_motor", 0.0, beside, alone)
    assert variance_between_sets([possible], "thrust_coefficient", 0) == pytest.approx(0.5 * 0.02**2)
    assert variance_between_sets([], "thrust_coefficient", 0) == 0.0


def test_an_effect_that_may_act_is_neither_proven_nor_clearly_less_probable() -> None:
    """Three tilts with larger odds do not crowd out the weak rotor 4."""
    tilts = {f"motor_tilt {rotor}": odds for rotor, odds in ((1, 1.5), (2, 2.0), (3, 1.0))}
    possible = rotor_search({"weak_motor 4": 0.9, "weak_motor 3": -3.3, **tilts}).possible_additions(make_fit())
    labels = [(f"{one.name} {one.fitted.params.effects[one.name][0]:.0f}", one.log_odds) for one in possible]
    assert labels == [("motor_tilt 2", 2.0), ("motor_tilt 1", 1.5), ("motor_tilt 3", 1.0), ("weak_motor 4", 0.9)]
