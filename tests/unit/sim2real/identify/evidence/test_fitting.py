"""Fitted sets of effects: how probable each is, and what a robot file can hold of one."""

from math import exp

import pytest

from aerial_gym.sim2real.identify.candidates.nuisance import Nuisance
from aerial_gym.sim2real.identify.evidence.fitting import NOTHING, Fitted, Fitter, inclusion_in, probabilities_of
from aerial_gym.sim2real.predict.model_params import ModelParams

PLACE = Nuisance(kind="position", channel="specific_force.x", columns=[])


def fitted(*effects: str, log: float, structures: tuple[Nuisance, ...] = ()) -> Fitted:
    """Return a fitted set of a log posterior."""
    return Fitted(
        effects=effects,
        structures=structures,
        params=ModelParams(effects={}),
        log_posterior=log,
        parameters=NOTHING,
        support={},
    )


@pytest.mark.parametrize("overdispersion", [1.0, 4.0])
def test_odds_are_those_of_evidence_over_the_overdispersion(overdispersion: float) -> None:
    """Two sets 3 apart: odds of e³, and of e^(3/4) where parameters scatter twice as far as by noise."""
    sets = [fitted("rotor_drag", log=-100.0), fitted("quadratic_drag", log=-103.0)]
    found = probabilities_of(sets, overdispersion=overdispersion)
    assert list(found) == [("rotor_drag",), ("quadratic_drag",)]
    assert found["rotor_drag",] / found["quadratic_drag",] == pytest.approx(exp(3.0 / overdispersion))
    assert sum(found.values()) == pytest.approx(1.0)


def test_the_same_effects_beside_other_structures_are_one_set() -> None:
    """Two of the same evidence beside another: two thirds; an effect has the probability of all sets that hold it."""
    sets = [
        fitted("payload_mass", "rotor_drag", log=-5.0),
        fitted("rotor_drag", "payload_mass", log=-5.0, structures=(PLACE,)),
        fitted("rotor_drag", log=-5.0),
    ]
    found = probabilities_of(sets, overdispersion=1.0)
    assert found == {("payload_mass", "rotor_drag"): pytest.approx(2 / 3), ("rotor_drag",): pytest.approx(1 / 3)}
    assert inclusion_in(found) == {"rotor_drag": pytest.approx(1.0), "payload_mass": pytest.approx(2 / 3)}


def test_of_a_fit_that_went_nowhere_an_effect_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pendulum over the top has no evidence and no support: it is tried without an effect."""
    monkeypatch.setattr(Fitter, "without", lambda _self, _fitted, names: names)
    nowhere = fitted("slung_payload", "rotor_drag", log=float("-inf"))
    assert not nowhere.holds
    assert Fitter.without_weakest(object.__new__(Fitter), nowhere) == ("slung_payload",)
