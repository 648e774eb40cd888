"""What a verdict says of what it does not know: doubt stays with the effect that it is about, and advice with the vehicle."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.least_squares.covariance import uncertainty
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit
from aerial_gym.sim2real.identify.least_squares.moments import block_moments
from aerial_gym.sim2real.judge import verdict
from aerial_gym.sim2real.judge.analysis import about_logs, not_testable
from aerial_gym.sim2real.judge.evaluation import evaluate, missing_for_rollouts
from aerial_gym.sim2real.judge.outcome import Outcome, meaning, said_first
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.statistics import Rise
from tests.unit.sim2real.fitted_sets import chosen_of, fitted, selection_of
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

TIES = {"rotor_drag": [], "com_offset": ["motor_tilt", "weak_motor"], "imu_bias": []}


def test_doubt_about_one_effect_is_not_put_on_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "tied_rivals", lambda name, selection: TIES[name])
    selection = SimpleNamespace(accepted=tuple(TIES))
    kind, reason, candidates = verdict.decide(selection, ("rotor_speed.1",), floor_known=True)  # type: ignore[arg-type]
    assert (kind, candidates) == ("ambiguous", ("rotor_drag", "com_offset", "imu_bias", "motor_tilt", "weak_motor"))
    assert reason == (
        "com_offset cannot be told from motor_tilt or weak_motor; "
        "more than noise and tolerances remains in rotor_speed.1"
    )
    text = meaning("ambiguous", [], TIES)
    assert "com_offset may as well be motor_tilt or weak_motor: fly what tells" in text
    assert "Not touched by this doubt: rotor_drag, imu_bias." in text
    assert "may as well" not in meaning(
        "ambiguous", [], {"rotor_drag": []}
    )  # what remains is in doubt, not what is named
    assert "training flights do not show" in meaning("ambiguous", [], {"rotor_drag": []})


def test_what_training_leaves_open_is_not_called_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "tied_rivals", lambda name, selection: [])
    found, nothing = SimpleNamespace(accepted=("rotor_drag",)), SimpleNamespace(accepted=())
    _, reason, _ = verdict.decide(found, (), True, left_open=("specific_force.x",))  # type: ignore[arg-type]
    assert reason.endswith(
        "what remains in specific_force.x is no more than they leave open: fly more to know it better"
    )
    _, reason, _ = verdict.decide(found, (), True)  # type: ignore[arg-type]
    assert reason == "the flights show rotor_drag; what remains is near the noise floor"
    _, reason, _ = verdict.decide(found, (), True, of_flights=("specific_force.x",))  # type: ignore[arg-type]
    assert reason == (
        "the flights show rotor_drag; each flight has an offset of its own in specific_force.x; "
        "what else remains is near the noise floor"
    )
    kind, reason, _ = verdict.decide(nothing, (), True, of_flights=("specific_force.x",))  # type: ignore[arg-type]
    assert kind == "none"
    assert reason.endswith("within noise and tolerances; each flight has an offset of its own in specific_force.x")
    kind, reason, _ = verdict.decide(nothing, (), True, left_open=("angular_acceleration.z",))  # type: ignore[arg-type]
    assert kind == "not shown"
    assert reason == (
        "the flights show no registered effect; what remains in angular_acceleration.z is no more than the training flights "
        "leave open"
    )
    assert "as far as the training flights show it" in meaning(kind, [])


def test_nobody_is_sent_to_fly_for_arms_that_a_vehicle_does_not_have() -> None:
    wind = SimpleNamespace(wind=SimpleNamespace(untestable=""))
    hidden = SimpleNamespace(not_testable={"joint_spring": "needed: x", "ground_effect": "needed: y"}, accepted=())
    rigid, soft = (SimpleNamespace(effects=effects, joints=None) for effects in ({}, {"joint_creep": {}}))
    told = not_testable(hidden, rigid, wind)  # type: ignore[arg-type]
    assert told["joint_spring"] == "its file gives the vehicle no soft arms, and these flights show none"
    assert told["ground_effect"] == "needed: y"
    assert not_testable(hidden, soft, wind)["joint_spring"] == "needed: x"  # type: ignore[arg-type]


def test_a_look_alike_that_nobody_registered_is_told_beside_what_it_looks_like(monkeypatch: pytest.MonkeyPatch) -> None:
    """As an effect of a user may name one; of a named effect alone, for nothing looks like what is not there."""
    monkeypatch.setattr(EFFECTS.get("rotor_drag"), "confused_with", ("quadratic_drag", "drag_of_a_tether"))
    wind = SimpleNamespace(wind=SimpleNamespace(untestable=""))
    named, robot = SimpleNamespace(not_testable={}, accepted=("rotor_drag",)), SimpleNamespace(effects={}, joints=None)
    assert not_testable(named, robot, wind) == {  # type: ignore[arg-type]
        "drag_of_a_tether": "looks like rotor_drag; there is no registered effect of this name to weigh it"
    }
    named.accepted = ()
    assert not_testable(named, robot, wind) == {}  # type: ignore[arg-type]


def test_without_a_noise_floor_nothing_is_called_near_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "tied_rivals", lambda name, selection: [])
    found, nothing = SimpleNamespace(accepted=("rotor_drag",)), SimpleNamespace(accepted=())
    kind, reason, _ = verdict.decide(found, (), False)  # type: ignore[arg-type]
    assert kind == "explained"
    assert reason == "the flights show rotor_drag; the logs are too slow or short to show a noise floor"
    kind, reason, _ = verdict.decide(nothing, (), False)  # type: ignore[arg-type]
    assert kind == "none"
    assert reason.endswith(
        "the logs are too slow or short to show a noise floor: whether more than noise remains cannot be told"
    )


def test_a_note_on_several_logs_is_one_note() -> None:
    notes = {"a": ("without velocity", "slow"), "b": ("without velocity",), "c": ("without velocity", "gap", "slow")}
    flights = [SimpleNamespace(name=name, notes=own, rate=100.0) for name, own in notes.items()]
    declared = SimpleNamespace(
        flights=flights, bandwidth=10.0, asked_bandwidth=10.0, train=SimpleNamespace(flights=flights)
    )
    told = about_logs(declared)  # type: ignore[arg-type]
    assert told == ["all logs: without velocity", "a, c: slow", "c: gap"]


def test_rollouts_are_made_only_of_logs_that_hold_where_they_begin(tmp_path) -> None:
    """One log without velocity: its windows would begin at rest, and be called errors of the model."""
    paths = [write(flight(seed, seconds=4.0, rate=100.0), tmp_path / f"f{seed}.csv") for seed in (1, 2)]
    whole = load_flights(paths, ROBOT, mapping=None, bandwidth=10.0)
    blind = replace(whole[1], lin_vel=None, position=None)
    turning = replace(whole[0], attitude_integrated=True)
    assert missing_for_rollouts(whole) == ""
    assert missing_for_rollouts([whole[0], blind]) == "f2: without velocity or position"
    assert missing_for_rollouts([turning, replace(whole[1], attitude_integrated=True)]).startswith(
        "all logs: without attitude"
    )
    for flights, made in (([whole[0], blind], False), ([turning, whole[1]], False), (whole, True)):
        channels = find_channels(flights)
        test = Predictor(ROBOT, flights, bandwidth=10.0, channels=channels, tolerances=Tolerances())
        (found,) = evaluate(ROBOT, test, [ModelParams()], floor=np.ones(len(channels)), seed=0)
        assert bool(found.rollouts) is made


@pytest.mark.parametrize(("behind", "confidence"), [(np.log(4.0), 0.8), (40.0, verdict.MOST_CONFIDENT)])
def test_an_effect_is_as_sure_as_the_sets_that_hold_it_are_probable(behind: float, confidence: float) -> None:
    """Odds of 4 to 1 are 80 %; nothing is certain."""
    rng = np.random.default_rng(0)
    times, best = [np.arange(240) / 30.0] * 3, fitted("rotor_drag")
    fit = Fit(
        effects=("rotor_drag",),
        params=best.params,
        moments=block_moments(times, list(rng.normal(size=(3, 240, 1))), list(rng.normal(size=(3, 240, 1, 3)))),
        low=np.full(3, -np.inf),
        high=np.full(3, np.inf),
        num_effect_params=3,
    )
    final = SimpleNamespace(effects=fit.effects, fit=fit, spread=uncertainty(fit, np.ones(1)))
    selection = selection_of(chosen_of(best, fitted(log=-behind)), final=final)  # type: ignore[arg-type]
    (named,) = verdict.named_effects(selection, {"rotor_drag": None}, {"rotor_drag": None})  # type: ignore[dict-item]
    assert named.confidence == pytest.approx(confidence)
    assert named.confidence == min(selection.chosen.inclusion["rotor_drag"], verdict.MOST_CONFIDENT)
    assert list(named.std) == ["dx", "dy", "dz"]


@pytest.mark.parametrize("harm", [True, False])
def test_what_gets_worse_is_said_before_what_failed(harm: bool) -> None:
    rise = Rise(value=0.62, low=0.4, high=0.9)
    worse = (Outcome(name="force", about="force", where="", rise=rise, least=0.05),) if harm else ()
    first = said_first(worse)
    reason = "; ".join(part for part in (first, "the flights show rotor_drag") if part)
    found = verdict.Verdict.told_before(SimpleNamespace(outcomes=worse, reason=reason), "rotor 2 stops; up to then: ")  # type: ignore[arg-type]
    assert first.startswith("worse on the test flights: force") is harm
    assert found == "; ".join(
        part for part in (first, "rotor 2 stops; up to then: the flights show rotor_drag") if part
    )


@pytest.mark.parametrize("failed", [True, False])
def test_what_is_not_shown_is_not_said_to_be_explained(failed: bool) -> None:
    """Where a failure alone is told, the declared vehicle is not said to make all; beside a name it is said what is open."""
    left = ("angular_acceleration.z",)
    failures = (SimpleNamespace(flight="train_1"),) if failed else ()
    effects = () if failed else (SimpleNamespace(name="rotor_drag", ties=()),)
    told = SimpleNamespace(
        verdict="explained", failures=failures, differing_joints=[], effects=effects, outcomes=(), not_shown=left
    )
    text = verdict.Verdict.meaning.fget(told)  # type: ignore[attr-defined]
    assert ("as far as the training flights show it" in text) is failed
    assert ("in angular_acceleration.z the training flights leave open" in text) is not failed
    assert "nothing is to be corrected" not in text
    told.not_shown = ()
    assert "open" not in verdict.Verdict.meaning.fget(told)  # type: ignore[attr-defined]
