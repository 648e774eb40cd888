"""What a verdict says of what it does not know: doubt stays with the effect that it is about, and advice with the vehicle."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.covariance import uncertainty
from aerial_gym.sim2real.identify.least_squares.gauss_newton import ModelFit
from aerial_gym.sim2real.identify.least_squares.moments import block_moments
from aerial_gym.sim2real.judge import verdict
from aerial_gym.sim2real.judge.analysis import about_logs, not_testable
from aerial_gym.sim2real.judge.evaluation import evaluate, rollout_gap
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection


def test_nobody_is_sent_to_fly_for_arms_that_a_vehicle_does_not_have() -> None:
    wind = SimpleNamespace(wind=SimpleNamespace(untestable=None))
    unseen = {name: Finding("not_excited", name) for name in ("joint_spring", "ground_effect")}
    hidden = SimpleNamespace(not_testable=unseen, effect_names=())
    rigid, soft = (SimpleNamespace(effects=effects, joints=None) for effects in ({}, {"joint_creep": {}}))
    told = not_testable(hidden, rigid, wind)
    assert [told[name].code for name in unseen] == ["no_soft_arms", "not_excited"]
    assert not_testable(hidden, soft, wind)["joint_spring"].code == "not_excited"


def test_a_look_alike_that_nobody_registered_is_told_beside_what_it_looks_like(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EFFECTS.get("rotor_drag"), "confused_with", ("quadratic_drag", "drag_of_a_tether"))
    wind = SimpleNamespace(wind=SimpleNamespace(untestable=None))
    named, robot = (
        SimpleNamespace(not_testable={}, effect_names=("rotor_drag",)),
        SimpleNamespace(effects={}, joints=None),
    )
    assert not_testable(named, robot, wind) == {
        "drag_of_a_tether": Finding("no_such_effect", "drag_of_a_tether", {"alike": "rotor_drag"})
    }
    named.effect_names = ()
    assert not_testable(named, robot, wind) == {}


def test_a_note_on_several_logs_is_one_note() -> None:
    blind, slow, gap = (Finding(code) for code in ("velocity_unknown", "rates_derived", "rows_copied"))
    notes = {"a": (blind, slow), "b": (blind,), "c": (blind, gap, slow)}
    flights = [SimpleNamespace(name=name, notes=own, rate=100.0) for name, own in notes.items()]
    declared = SimpleNamespace(
        flights=flights, bandwidth=10.0, asked_bandwidth=10.0, train=SimpleNamespace(flights=flights)
    )
    told = about_logs(declared)
    assert [(note.subject, note.code) for note in told] == [
        ("all logs", "velocity_unknown"),
        ("a, c", "rates_derived"),
        ("c", "rows_copied"),
    ]


def test_rollouts_are_made_only_of_logs_that_hold_where_they_begin(tmp_path) -> None:
    """One log without velocity: its windows would begin at rest, and be called errors of the model."""
    paths = [write(flight(seed, seconds=4.0, rate=100.0), tmp_path / f"f{seed}.csv") for seed in (1, 2)]
    whole = load_flights(paths, ROBOT, mapping=None, bandwidth=10.0)
    blind = replace(whole[1], lin_vel=None, position=None)
    turning = replace(whole[0], attitude_integrated=True)
    assert rollout_gap(whole) is None
    assert rollout_gap([whole[0], blind]) == Finding("rollouts_lack_velocity", "f2")
    both = [turning, replace(whole[1], attitude_integrated=True)]
    assert rollout_gap(both) == Finding("rollouts_lack_attitude", "all logs")
    for flights, made in (([whole[0], blind], False), ([turning, whole[1]], False), (whole, True)):
        channels = find_channels(flights)
        test = Predictor(ROBOT, flights, bandwidth=10.0, channels=channels, tolerances=Tolerances())
        (result,) = evaluate(ROBOT, test, [ModelParams()], floor=np.ones(len(channels)), seed=0)
        assert bool(result.rollouts) is made


@pytest.mark.parametrize(("behind", "confidence"), [(np.log(4.0), 0.8), (40.0, verdict.MOST_CONFIDENT)])
def test_an_effect_is_as_sure_as_the_sets_that_hold_it_are_probable(behind: float, confidence: float) -> None:
    """Odds of 4 to 1 are 80 %; nothing is certain."""
    rng = np.random.default_rng(0)
    times, best = [np.arange(240) / 30.0] * 3, make_fit("rotor_drag")
    fit = ModelFit(
        effects=("rotor_drag",),
        params=best.params,
        moments=block_moments(times, list(rng.normal(size=(3, 240, 1))), list(rng.normal(size=(3, 240, 1, 3)))),
        low=np.full(3, -np.inf),
        high=np.full(3, np.inf),
        num_effect_params=3,
    )
    final = SimpleNamespace(effects=fit.effects, fit=fit, spread=uncertainty(fit, np.ones(1)))
    selection = make_selection(make_choice(best, make_fit(log=-behind)), final=final)
    (named,) = verdict.effect_entries(selection, {"rotor_drag": None}, {"rotor_drag": None}, ROBOT)
    assert named.confidence == pytest.approx(confidence)
    assert named.confidence == min(selection.chosen.inclusion["rotor_drag"], verdict.MOST_CONFIDENT)
    assert list(named.std) == ["dx", "dy", "dz"]
