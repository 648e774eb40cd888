"""Verdicts: kind, candidates, doubts, notes, failures of single flights, and the answer in its parts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real import judge_flights
from aerial_gym.sim2real.failures.flight_event import Failure
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.nuisance import OF_FLIGHTS, NuisanceColumns
from aerial_gym.sim2real.identify.candidates.structure import Structure
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.identify.selection.partial_rivals import ParameterRival
from aerial_gym.sim2real.judge import failure_verdict, verdict
from aerial_gym.sim2real.judge.ablation import Ablation
from aerial_gym.sim2real.judge.analysis import (
    LoopResult,
    correct_robot,
    notes_on_bounds,
    notes_on_implausible_deviations,
    notes_on_logs,
    notes_on_surrogates_and_offsets,
    untestable_effects,
)
from aerial_gym.sim2real.judge.answer import answer_parts, trust_findings
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation, evaluate_models, reason_against_rollouts
from aerial_gym.sim2real.judge.experiments.design import Advice
from aerial_gym.sim2real.judge.outcome import Decision, Outcome, verdict_decision
from aerial_gym.sim2real.judge.verdict import Verdict, notes_on_laws
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.statistics import Rise
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor
from tests.unit.sim2real.judge.builders import (
    make_evaluation,
    make_excess,
    make_named_effect,
    make_outcome,
    make_setup,
    make_verdict,
)
from tests.unit.sim2real.predict.test_scene import hover
from tests.unit.sim2real.set_fits import PLACE, make_choice, make_fit, make_selection

NO_EXCESS = make_excess()


def test_nobody_is_sent_to_fly_for_arms_that_a_vehicle_does_not_have() -> None:
    unseen = {name: Finding("not_excited", name) for name in ("joint_spring", "ground_effect")}
    hidden, soft = make_selection(not_testable=unseen), replace(ROBOT, effects={"joint_creep": {}})
    told = untestable_effects(hidden, ROBOT, NO_EXCESS)
    assert [told[name].code for name in unseen] == ["no_soft_arms", "not_excited"]
    assert untestable_effects(hidden, soft, NO_EXCESS)["joint_spring"].code == "not_excited"


def test_parameters_at_a_bound_are_a_note_on_a_named_effect() -> None:
    """A drag of 0 is where the effect begins, one of 10 N s/m the largest that is possible."""
    fitted = make_fit("rotor_drag", params={"rotor_drag": [10.0, 0.0, 0.3]})
    notes = notes_on_bounds(make_setup(), make_selection(make_choice(fitted)))
    assert notes == [Finding("at_bound", "rotor_drag", {"parameters": ["dx"]})]


def test_the_law_of_an_effect_is_a_note_and_its_cause_the_name() -> None:
    """A curve 7 more probable than the formula: no tie, but a preference; the verdict has the name of the cause."""
    curve, formula = make_fit("ground_effect_curve", log=0.0), make_fit("ground_effect", log=-7.0)
    selection = make_selection(make_choice(curve, formula))
    values = {"law": "curve", "other": "formula", "log_odds": 7.0}
    assert notes_on_laws(selection) == [Finding("law_preferred", "ground_effect_curve", values)]
    assert (
        verdict.names_of_ties(
            "ground_effect_curve", make_selection(make_choice(curve, make_fit("ground_effect", log=-1.0)))
        )
        == []
    )
    tied = make_selection(make_choice(make_fit("quadratic_drag"), make_fit("quadratic_drag_of_axes", log=-1.0)))
    assert [(note.code, note.values["log_odds"]) for note in notes_on_laws(tied)] == [("laws_tied", 1.0)]
    assert tied.effect_ties("quadratic_drag") == []
    assert tied.inclusion == {"quadratic_drag": pytest.approx(1.0)}
    told = make_named_effect("ground_effect_curve", params={"g1": 0.1}).as_mapping()
    assert (told["name"], told["law"]) == ("ground_effect", "curve")
    assert verdict.cause_shares({"ground_effect": 0.2, "ground_effect_curve": 0.7}) == {
        "ground_effect": pytest.approx(0.9)
    }


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
    assert named.confidence == min(selection.inclusion["rotor_drag"], verdict.MOST_CONFIDENT)
    assert list(named.std) == ["dx", "dy", "dz"]


X, Z = ("specific_force.x",), ("angular_acceleration.z",)
DRAG = ("rotor_drag",)


def codes(decision: Decision) -> list[str]:
    return [finding.code for finding in decision.findings]


def test_doubt_about_one_effect_is_not_put_on_the_others() -> None:
    ties = {"rotor_drag": [], "com_offset": ["motor_tilt", "weak_motor"], "imu_bias": []}
    decision = verdict_decision(ties, ("rotor_speed.1",), floor_known=True)
    assert decision.kind == "ambiguous"
    assert decision.candidates == ("rotor_drag", "com_offset", "imu_bias", "motor_tilt", "weak_motor")
    tie, rest = decision.findings
    assert (tie.code, tie.subject) == ("effect_tied", "com_offset")
    assert tie.values == {"others": ["motor_tilt", "weak_motor"]}
    assert (rest.code, rest.values) == ("remains_unexplained", {"channels": ["rotor_speed.1"]})


@pytest.mark.parametrize(("effects", "remains", "kind", "expected"), [
    (DRAG, {}, "explained", ["remains_near_floor"]),
    (DRAG, {"left_open": X}, "explained", ["left_open"]),
    (DRAG, {"of_flights": X}, "explained", ["offsets_of_flights", "remains_near_floor"]),
    (DRAG, {"unexplained": X}, "unexplained", ["remains_unexplained"]),
    (DRAG, {"unexplained": X, "open_to": ("gusts",)}, "ambiguous", ["remains_unexplained", "effects_open"]),
    (DRAG, {"floor_known": False}, "explained", ["floor_unknown"]),
    ((), {}, "none", []),
    ((), {"of_flights": X}, "none", ["offsets_of_flights"]),
    ((), {"left_open": Z}, "not shown", ["left_open"]),
    ((), {"unexplained": X}, "unexplained", ["remains_unexplained"]),
    ((), {"floor_known": False}, "none", ["floor_unknown"]),
])  # fmt: skip
def test_kind_and_open_points_follow_from_what_remains(effects, remains, kind, expected) -> None:
    given = {"unexplained": (), "floor_known": True} | remains
    decision = verdict_decision(dict.fromkeys(effects, ()), **given)
    assert (decision.kind, codes(decision)) == (kind, expected)
    assert decision.candidates == (*effects, *given.get("open_to", ()))


GUSTS = {"std": 1.5, "corr_time": 0.8, "vertical": 0.6, "vertical_time": 0.5}
RANDOM = {"gusts": GUSTS, "random_force": {"x": 0.1, "y": 0.1, "z": 0.2, "hold": 0.01}}


def mass_notes(size: float, left: list[float]) -> list[Finding]:
    """Return the notes where the mass is off by ``size`` deviations, which leaves such forces in place of 0.2 m/s²."""
    deviation = np.zeros(len(names := Tolerances().names(4)))
    deviation[names.index("mass")] = size
    excess = make_excess(deviation, left=[np.outer([1.0, -1.0], left)])
    return notes_on_implausible_deviations(
        make_setup([hover("a", 5.0)]), ModelParams(), Criteria().material, excess, make_evaluation(0.2, 0.2, 0.2)
    )


@pytest.mark.parametrize(
    ("left", "changed"),
    [([0.2, 0.1, 0.27], {"specific_force.y": (0.1, 0.2), "specific_force.z": (0.27, 0.2)}), ([0.2, 0.199, 0.201], {})],
)
def test_of_a_strained_tolerance_it_is_said_what_it_changes(left, changed) -> None:
    first, last = mass_notes(4.0, left)
    assert first == Finding("tolerance_strained", "mass", {"deviation_std": 4.0})
    assert last.code == ("strained_changes" if changed else "strained_changes_little")
    errors = {row["channel"]: (row["with_m_s2"], row["without_m_s2"]) for row in last.values.get("errors", ())}
    assert errors == {channel: pytest.approx(pair) for channel, pair in changed.items()}
    assert mass_notes(2.0, left) == []


@pytest.mark.parametrize(("count", "band", "told"), [
    (3, 10.0, {}),
    (3, 10.0 - 1e-9, {"band_limited": {"band_hz": 10.0 - 1e-9, "slowest_hz": 50.0}}),
    (2, 10.0, {"few_flights": {"flights": 2}}),
    (1, 5.0, {"band_limited": {"band_hz": 5.0, "slowest_hz": 50.0}, "few_flights": {"flights": 1}}),
])  # fmt: skip
def test_slow_logs_and_few_flights_are_told(count: int, band: float, told: dict[str, dict]) -> None:
    flights = [hover(f"f{n}", 5.0, rate=50.0 + n) for n in range(count)]
    assert {note.code: note.values for note in notes_on_logs(make_setup(flights, band=band))} == told


def test_an_effect_that_only_stands_in_for_a_structure_is_told_with_it() -> None:
    chosen = make_choice(make_fit(), surrogates={"thrust_coefficient": "time"})
    (note,) = notes_on_surrogates_and_offsets(make_selection(chosen))
    assert note == Finding("stands_in", "thrust_coefficient", {"structure": "time", "flights": 2})
    assert notes_on_surrogates_and_offsets(make_selection(make_choice(make_fit()))) == []


def test_offsets_that_each_flight_has_of_its_own_are_told_with_their_size() -> None:
    own = NuisanceColumns(kind=OF_FLIGHTS, channel="specific_force.x", columns=[], size=0.0123)
    (note,) = notes_on_surrogates_and_offsets(make_selection(make_choice(make_fit(structures=(own, PLACE)))))
    assert note.code == "offsets_sizes"
    assert note.values == {"offsets": [{"channel": "specific_force.x", "rms_m_s2": 0.0123}]}
    assert notes_on_surrogates_and_offsets(make_selection(make_choice(make_fit(structures=(PLACE,))))) == []


def test_what_is_random_in_a_robot_file_stays_in_the_corrected_one() -> None:
    robot = replace(ROBOT, effects={**RANDOM, "rotor_drag": {"dx": 0.1, "dy": 0.1, "dz": 0.0}}, effects_source="test")
    declared = make_setup([hover("a", 5.0)], robot)
    params = params_from_robot(robot).with_effect("payload_mass", np.array([0.02]))
    result = correct_robot(declared, params, ["payload_mass"]).effects
    assert {name: result[name] for name in RANDOM} == RANDOM
    assert {"rotor_drag", "payload_mass"} == set(result) - set(RANDOM)
    params = params.with_effect("gusts", np.array([2.0, 0.5, 1.0, 1.0]))
    result = correct_robot(declared, params, ["payload_mass", "gusts"]).effects
    assert result["gusts"] == {"std": 2.0, "corr_time": 0.5, "vertical": 1.0, "vertical_time": 1.0}


OTHER = Finding("velocity_unknown")


def make_result() -> LoopResult:
    params, verdict = ModelParams(), make_verdict("none", notes=(OTHER,))
    given = {"declared": make_setup(), "selection": make_selection(), "verdict": verdict}
    return LoopResult(**given, params=params, within=params, corrected=ROBOT)


def make_failure(name: str, params: dict[str, float]) -> Failure:
    spans = {"time": (2.9, 3.1), "scale": (0.4, 0.6)}
    return Failure(
        flight="f1", name=name, params=params, interval=spans, log_odds=24.81, probability=0.9, rival="stuck_rotor"
    )


@pytest.mark.parametrize(("name", "params", "trains"), [
    ("motor_failure", {"motor": 2.0, "scale": 0.5, "time": 3.0}, {"motor": 2.0, "scale": 0.5, "time": 3.0}),
    # A propeller that gives 0.81 of its thrust, as at 0.9 of its speed: the effect has no onset.
    ("weak_motor", {"motor": 1.0, "scale": 0.81, "time": 4.0}, {"motor": 1.0, "scale": 0.9, "time": 4.0}),
])  # fmt: skip
def test_a_failure_of_one_flight_is_noted_with_the_effect_that_trains_with_it(name, params, trains) -> None:
    failure = make_failure(name, params)
    told = failure_verdict.result_with_failures(make_result(), [failure], 2).verdict
    assert (told.verdict, told.failures) == ("explained", (failure,))
    note, other = told.notes
    assert other is OTHER
    assert (note.code, note.subject, note.values["effect"]) == ("train_with_failure", "f1", "motor_failure")
    assert note.values["params"] == pytest.approx(trains)


def test_what_looks_like_a_failure_is_noted_and_changes_nothing_else() -> None:
    judged = make_result()
    failure = make_failure("motor_failure", {"time": 3.0})
    told = failure_verdict.result_with_suspicions(judged, [failure])
    expected = Finding("failure_suspected", "f1", {**failure.finding.values, "log_odds": 24.81})
    assert told == replace(judged, verdict=replace(judged.verdict, notes=(OTHER, expected)))
    assert failure_verdict.result_with_suspicions(judged, []) is judged


KINDS = ("specific_force", "angular_acceleration", "kinematic_force")
CHANNELS = tuple(Channel(kind=kind, axis=axis) for kind in KINDS for axis in "xyz")
EFFECT, TIED = make_named_effect(), make_named_effect(ties=("weak_motor",))


def model(*rms: float) -> ModelEvaluation:
    """Return an evaluation with these errors of the channels, above floors of 0.1."""
    return make_evaluation(*rms, channels=CHANNELS, floor=0.1)


def outcome(quantity: str, value: float) -> Outcome:
    return make_outcome(quantity, value, value - 0.01, value + 0.01)


def unit_verdict(kind: str, **more: Any) -> Verdict:
    return make_verdict(kind, **{"before": model(*[1.0] * 9), "after": model(*[1.0] * 9)} | more)


def statement_codes(parts: dict[str, tuple[Finding, ...]]) -> list[list[str]]:
    return [[finding.code for finding in part] for part in parts.values()]


@pytest.mark.parametrize(
    ("kind", "more", "expected"),
    [
        ("none", {}, [["declared_explains"], [], [], ["keep_declared"]]),
        ("none", {"open_points": (Finding("floor_unknown"),)}, [["effects_none"], [], ["floor_unknown"], ["log_faster"]]),
        ("not shown", {"open_points": (Finding("left_open"),)}, [["effects_none"], [], ["left_open"], ["train_like_test"]]),
        ("ambiguous", {"effects": (TIED,)}, [["effect_found"], [], [], ["weigh_or_log"]]),
        ("explained", {"joint_findings": (Finding("joint_found", "arm0"),)},
         [["joint_found", "declared_explains"], [], [], ["load_robot_file"]]),
    ],
)  # fmt: skip
def test_each_kind_of_verdict_has_its_statements(kind: str, more: dict[str, Any], expected: list[list[str]]) -> None:
    assert statement_codes(answer_parts(unit_verdict(kind, **more))) == expected


def test_an_effect_that_test_flights_do_not_show_is_no_claim() -> None:
    rise = Rise(value=0.1, low=-0.1, high=0.3)
    worth = Ablation(residual={"specific_force.x": rise}, rollout={}, least=0.05, rivals=())
    hidden = make_named_effect(ablation=worth)
    told = unit_verdict("not shown", effects=(hidden,))
    assert statement_codes(answer_parts(told)) == [["effect_found", "materiality_open"], [], [], ["test_like_train"]]
    assert hidden.finding.values["material"] is None
    assert "material" not in EFFECT.finding.values
    assert [one.code for one in trust_findings(told)] == ["trust_as_trained"]
    assert [effect["material"] for effect in told.as_mapping()["effects"]] == [None]


def test_a_correction_names_the_largest_gains_and_the_largest_harm() -> None:
    changes = {
        "specific_force.x": -0.9, "specific_force.y": -0.2, "angular_acceleration.x": 0.3,
        "angular_acceleration.y": -0.97, "angular_acceleration.z": 0.1, "kinematic_force.x": -0.99,
    }  # fmt: skip
    became = tuple(outcome(quantity, rise) for quantity, rise in changes.items())
    after = model(0.1, 0.8, 1, 1.3, 0.03, 1.1, 0.01, 1, 1)
    statement = answer_parts(unit_verdict("explained", effects=(EFFECT,), outcomes=became, after=after))
    (gain,), (harm,) = statement["gain"], statement["open"]
    errors = [(row["quantity"], row.get("after_m_s2", row.get("after_rad_s2"))) for row in gain.values["errors"]]
    assert errors == [("angular_acceleration.y", 0.03), ("specific_force.x", 0.1)]
    assert (harm.code, harm.subject) == ("error_rises", "angular_acceleration.x")
    assert (harm.values["after_rad_s2"], harm.values["more"]) == (1.3, 1)
    (step,) = statement["next"]
    assert step == Finding("keep_declared_where", "", {"errors": ["angular_acceleration.x", "angular_acceleration.z"]})


@pytest.mark.parametrize(("rise", "step"), [(0.2, "keep_declared_for_harm"), (-0.001, "load_robot_file")])
def test_no_gain_is_claimed_without_one(rise: float, step: str) -> None:
    statement = answer_parts(
        unit_verdict("explained", effects=(EFFECT,), outcomes=(outcome("specific_force.x", rise),))
    )
    assert [one.code for one in (*statement["gain"], *statement["next"])] == ["no_error_falls", step]
    told = trust_findings(unit_verdict("explained", effects=(EFFECT,), outcomes=statement["gain"] and ()))
    assert "correction_helps" not in [one.code for one in told]


def test_an_unexplained_error_leads_with_its_size_over_the_noise_floor() -> None:
    point = Finding("remains_unexplained", "", {"channels": ["specific_force.z"]})
    structure = Structure(kind="position", channel="specific_force.z", share=0.6)
    rest = {"open_points": (point,), "unexplained": ("specific_force.z",), "structure": structure}
    statement = answer_parts(unit_verdict("unexplained", after=model(1, 1, 0.31, *[1] * 6), **rest))
    expected = [["remains_unexplained", "effects_none"], [], ["structure_found"], ["fly_structure"]]
    assert statement_codes(statement) == expected
    (error,) = statement["result"][0].values["errors"]
    assert error == {"channel": "specific_force.z", "rms_m_s2": 0.31, "floor_m_s2": 0.1}


def test_the_manoeuvre_that_decides_is_the_next_step() -> None:
    advice = Advice(fly="hover", tells=("com_offset", "weak_motor"), score=9.0, hover=1.0)
    statement = answer_parts(unit_verdict("ambiguous", effects=(TIED,), manoeuvre=advice))
    assert statement["next"] == (Finding("fly", "hover", {"tells": ["com_offset", "weak_motor"]}),)


def test_a_parameter_that_may_be_another_effect_is_not_stated_as_found() -> None:
    rival = ParameterRival(effect="com_offset", parameter="x", other="motor_tilt", params={}, log_odds=0.1)
    effect = make_named_effect(in_part=(rival,))
    assert "x_m" not in effect.finding.values
    assert "y_m" in effect.finding.values
    assert "parameters_tied" in [one.code for one in answer_parts(unit_verdict("explained", effects=(effect,)))["open"]]


@pytest.mark.slow
def test_an_unexplained_force_gets_a_learned_residual_unasked(tmp_path) -> None:
    """A pull to the origin, which no effect has; the residual learns what it can of it, or states why not."""
    tables = [flight(seed, seconds=6.0, rate=100.0, noise=1.0, spring=0.8, cubic=0.05) for seed in (1, 2, 3)]
    flights = load_tables(tmp_path, tables)
    judged = judge_flights(ROBOT, flights[:2], flights[2:], effects=("com_offset",)).verdict
    assert judged.verdict == "unexplained"
    assert judged.learned is not None
    if judged.learned.cfg is not None:
        assert set(judged.learned.named_gaps) == set(judged.learned.gaps)


def test_a_payload_is_tied_with_a_slung_load_that_the_logs_cannot_show() -> None:
    lacking = {name: Finding("logs_lack", name, {"need": "lin_vel"}) for name in ("slung_payload", "rotor_drag")}
    for code, ties in (("logs_lack", ["slung_payload"]), ("not_excited", [])):
        reasons = {name: replace(one, code=code) for name, one in lacking.items()}
        selection = make_selection(make_choice(make_fit("payload_mass"), make_fit(log=-40.0)), not_testable=reasons)
        assert verdict.names_of_ties("payload_mass", selection) == ties
    offset = make_selection(make_choice(make_fit("com_offset"), make_fit(log=-40.0)), not_testable=lacking)
    assert verdict.names_of_ties("com_offset", offset) == []


def test_without_rotor_speeds_a_sag_of_the_speed_is_tied_with_one_of_the_thrust() -> None:
    """Both follow the voltage; a constant thrust error does not, and logs with speeds compare the two."""
    for code, name, ties in (
        ("logs_lack", "battery_sag", ["thrust_voltage"]),
        ("logs_lack", "thrust_coefficient", []),
        ("voltage_too_steady", "battery_sag", []),
    ):
        reasons = {"thrust_voltage": Finding(code, "thrust_voltage", {"need": "rotor_speed"})}
        selection = make_selection(make_choice(make_fit(name), make_fit(log=-40.0)), not_testable=reasons)
        assert verdict.names_of_ties(name, selection) == ties


def test_rotors_that_flights_do_not_distinguish_are_ties_of_the_named_one() -> None:
    fitted = make_fit("weak_motor", params={"weak_motor": (1.0, 0.9)})
    selection = make_selection(make_choice(fitted, rotor_ties={"weak_motor": ("weak_motor 3", "motor_tilt 2")}))
    ties = {"weak_motor": verdict.names_of_ties("weak_motor", selection)}
    assert ties == {"weak_motor": ["weak_motor 3", "motor_tilt 2"]}
    assert verdict_decision(ties, (), floor_known=True).kind == "ambiguous"


def test_without_torques_a_thrust_is_tied_with_that_of_one_rotor() -> None:
    """Forces show the sum of the thrusts alone, but the sideways thrust of a tilted rotor."""
    reasons = {name: Finding("torques_not_compared", name) for name in ("weak_motor", "arm_length", "com_offset")}
    selection = make_selection(make_choice(make_fit("thrust_coefficient"), make_fit(log=-40.0)), not_testable=reasons)
    assert verdict.names_of_ties("thrust_coefficient", selection) == ["weak_motor"]
    tilted = make_selection(make_choice(make_fit("motor_tilt"), make_fit(log=-40.0)), not_testable=reasons)
    assert verdict.names_of_ties("motor_tilt", tilted) == []
