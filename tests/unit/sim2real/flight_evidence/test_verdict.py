"""The verdict of summed evidence on made-up sums: a named effect, clearly none, or open."""

import numpy as np

from aerial_gym.sim2real.flight_evidence.columns import candidates_of_columns, evidence_columns
from aerial_gym.sim2real.flight_evidence.evidence import FlightEvidence
from aerial_gym.sim2real.flight_evidence.verdict import verdict_of_sum
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT

COLUMNS = evidence_columns(ROBOT, Tolerances())


def evidence_of_rotor(value: float, rotor: int = 2, information: float = 400.0) -> FlightEvidence:
    """Return the evidence of a flight that every effect but a weak rotor contradicts, in units of its scale."""
    effects = np.array([bool(one.effect) for one in COLUMNS])
    product = np.diag(np.where(effects, information, 0.0))
    gradient = np.zeros(len(COLUMNS))
    owner = [(one.effect, one.rotor) for one in COLUMNS].index(("weak_motor", rotor))
    gradient[owner] = information * value
    return FlightEvidence(
        columns=COLUMNS, product=product, gradient=gradient, square=0.0, rows=100, effects=(), checks=(), events=(),
        duration_s=20.0, airframe="", firmware="", start_time=np.nan,
    )  # fmt: skip


def test_flights_that_contradict_every_effect_are_clearly_none() -> None:
    verdict = verdict_of_sum([evidence_of_rotor(0.0, information=1e6)] * 4)
    assert verdict is not None
    assert verdict.effects == ()
    assert verdict.is_clearly_none


def test_an_effect_that_no_flight_names_alone_is_named_by_the_sum() -> None:
    one = evidence_of_rotor(-0.15)
    alone, together = verdict_of_sum([one]), verdict_of_sum([one] * 12)
    assert alone is not None
    assert together is not None
    assert alone.effects == ()
    assert together.effects == ("weak_motor",)
    assert not together.is_clearly_none
    assert together.inclusion["weak_motor"] > 0.99


def test_no_flights_give_no_verdict() -> None:
    assert verdict_of_sum([]) is None


def test_candidates_have_all_columns_once_and_steps_that_begin_at_neutral() -> None:
    candidates = candidates_of_columns(COLUMNS)
    places = np.concatenate([*candidates.columns, candidates.tolerances])
    np.testing.assert_array_equal(np.sort(places), np.arange(len(COLUMNS)))
    assert [candidates.exclusive.count(name) for name in ("weak_motor", "slung_payload", "rotor_drag")] == [4, 5, 1]
    loads = [one for one in COLUMNS if one.effect == "slung_payload" and one.parameter == "mass"]
    assert [one.start for one in loads] == [1, 2, 3, 4, 5]
    assert all(one.neutral == 0.0 and one.low > 0.0 for one in loads)
    assert {one.rotor for one in COLUMNS if one.effect == "weak_motor"} == {1, 2, 3, 4}
