"""What a verdict says of what it does not know: doubt stays with the effect that it is about, and advice with the vehicle."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge import verdict
from aerial_gym.sim2real.judge.analysis import notes_on_logs, untestable_effects
from aerial_gym.sim2real.judge.evaluation import evaluate_models, reason_against_rollouts
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor
from tests.unit.sim2real.judge.builders import make_excess, make_setup
from tests.unit.sim2real.predict.test_scene import hover
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection

NO_EXCESS = make_excess()


def test_nobody_is_sent_to_fly_for_arms_that_a_vehicle_does_not_have() -> None:
    unseen = {name: Finding("not_excited", name) for name in ("joint_spring", "ground_effect")}
    hidden, soft = make_selection(not_testable=unseen), replace(ROBOT, effects={"joint_creep": {}})
    told = untestable_effects(hidden, ROBOT, NO_EXCESS)
    assert [told[name].code for name in unseen] == ["no_soft_arms", "not_excited"]
    assert untestable_effects(hidden, soft, NO_EXCESS)["joint_spring"].code == "not_excited"


def test_a_look_alike_that_nobody_registered_is_told_beside_what_it_looks_like(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EFFECTS.get("rotor_drag"), "confused_with", ("quadratic_drag", "drag_of_a_tether"))
    expected = Finding("no_such_effect", "drag_of_a_tether", {"alike": "rotor_drag"})
    named = make_selection(make_choice(make_fit("rotor_drag")))
    assert untestable_effects(named, ROBOT, NO_EXCESS) == {"drag_of_a_tether": expected}
    assert untestable_effects(make_selection(), ROBOT, NO_EXCESS) == {}


def test_a_note_on_several_logs_is_one_note() -> None:
    blind, slow, gap = (Finding(code) for code in ("velocity_unknown", "rates_derived", "rows_copied"))
    notes = {"a": (blind, slow), "b": (blind,), "c": (blind, gap, slow)}
    told = notes_on_logs(make_setup([hover(name, 1.0, notes=own) for name, own in notes.items()]))
    expected = [("all logs", "velocity_unknown"), ("a, c", "rates_derived"), ("c", "rows_copied")]
    assert [(note.subject, note.code) for note in told] == expected


def test_rollouts_are_made_only_of_logs_that_hold_where_they_begin(tmp_path) -> None:
    """One log without velocity: its windows would begin at rest, and be called errors of the model."""
    whole = load_tables(tmp_path, [flight(seed, seconds=4.0, rate=100.0) for seed in (1, 2)])
    blind = replace(whole[1], lin_vel=None, position=None)
    turning = replace(whole[0], attitude_integrated=True)
    assert reason_against_rollouts(whole) is None
    assert reason_against_rollouts([whole[0], blind]) == Finding("rollouts_lack_velocity", "f1")
    both = [turning, replace(whole[1], attitude_integrated=True)]
    assert reason_against_rollouts(both) == Finding("rollouts_lack_attitude", "all logs")
    for flights, made in (([whole[0], blind], False), ([turning, whole[1]], False), (whole, True)):
        test = make_predictor(flights)
        (result,) = evaluate_models(ROBOT, test, [ModelParams()], floor=np.ones(len(test.channels)), seed=0)
        assert bool(result.rollouts) is made


@pytest.mark.parametrize(("behind", "confidence"), [(np.log(4.0), 0.8), (40.0, verdict.MOST_CONFIDENT)])
def test_an_effect_is_as_sure_as_the_sets_that_hold_it_are_probable(behind: float, confidence: float) -> None:
    """Odds of 4 to 1 are 80 %; nothing is certain."""
    best = make_fit("rotor_drag")
    selection = make_selection(make_choice(best, make_fit(log=-behind)))
    (named,) = verdict.effects_of_selection(selection, {"rotor_drag": None}, {"rotor_drag": None}, ROBOT)
    assert named.confidence == pytest.approx(confidence)
    assert named.confidence == min(selection.chosen.inclusion["rotor_drag"], verdict.MOST_CONFIDENT)
    assert list(named.std) == ["dx", "dy", "dz"]
