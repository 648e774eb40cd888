"""The answer of a verdict: which statement stands in which part, with the numbers of the verdict."""

from typing import Any

import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.structure import Structure
from aerial_gym.sim2real.identify.selection.partial_rivals import ParameterRival
from aerial_gym.sim2real.judge.answer import answer_parts, trust_findings
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation
from aerial_gym.sim2real.judge.experiments.design import Advice
from aerial_gym.sim2real.judge.outcome import Outcome
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.predict.channels import Channel
from tests.unit.sim2real.judge.builders import make_evaluation, make_named_effect, make_outcome, make_verdict

CHANNELS = tuple(
    Channel(kind=kind, axis=axis)
    for kind in ("specific_force", "angular_acceleration", "kinematic_force")
    for axis in "xyz"
)
EFFECT, TIED = make_named_effect(), make_named_effect(ties=("weak_motor",))


def model(*rms: float) -> ModelEvaluation:
    """Return an evaluation with these errors of the channels, above floors of 0.1."""
    return make_evaluation(*rms, channels=CHANNELS, floor=0.1)


def outcome(quantity: str, value: float) -> Outcome:
    return make_outcome(quantity, value, value - 0.01, value + 0.01)


def verdict(kind: str, **more: Any) -> Verdict:
    return make_verdict(kind, **{"before": model(*[1.0] * 9), "after": model(*[1.0] * 9)} | more)


def codes(parts: dict[str, tuple[Finding, ...]]) -> list[list[str]]:
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
    assert codes(answer_parts(verdict(kind, **more))) == expected


def test_a_correction_names_the_largest_gains_and_the_largest_harm() -> None:
    changes = {
        "specific_force.x": -0.9, "specific_force.y": -0.2, "angular_acceleration.x": 0.3,
        "angular_acceleration.y": -0.97, "angular_acceleration.z": 0.1, "kinematic_force.x": -0.99,
    }  # fmt: skip
    became = tuple(outcome(quantity, rise) for quantity, rise in changes.items())
    after = model(0.1, 0.8, 1, 1.3, 0.03, 1.1, 0.01, 1, 1)
    statement = answer_parts(verdict("explained", effects=(EFFECT,), outcomes=became, after=after))
    (gain,), (harm,) = statement["gain"], statement["open"]
    errors = [(row["quantity"], row.get("after_m_s2", row.get("after_rad_s2"))) for row in gain.values["errors"]]
    assert errors == [("angular_acceleration.y", 0.03), ("specific_force.x", 0.1)]
    assert (harm.code, harm.subject) == ("error_rises", "angular_acceleration.x")
    assert (harm.values["after_rad_s2"], harm.values["more"]) == (1.3, 1)
    (step,) = statement["next"]
    assert step == Finding("keep_declared_where", "", {"errors": ["angular_acceleration.x", "angular_acceleration.z"]})


@pytest.mark.parametrize(("rise", "step"), [(0.2, "keep_declared_for_harm"), (-0.001, "load_robot_file")])
def test_no_gain_is_claimed_without_one(rise: float, step: str) -> None:
    statement = answer_parts(verdict("explained", effects=(EFFECT,), outcomes=(outcome("specific_force.x", rise),)))
    assert [one.code for one in (*statement["gain"], *statement["next"])] == ["no_error_falls", step]
    told = trust_findings(verdict("explained", effects=(EFFECT,), outcomes=statement["gain"] and ()))
    assert "correction_helps" not in [one.code for one in told]


def test_an_unexplained_error_leads_with_its_size_over_the_noise_floor() -> None:
    point = Finding("remains_unexplained", "", {"channels": ["specific_force.z"]})
    structure = Structure(kind="position", channel="specific_force.z", share=0.6)
    rest = {"open_points": (point,), "unexplained": ("specific_force.z",), "structure": structure}
    statement = answer_parts(verdict("unexplained", after=model(1, 1, 0.31, *[1] * 6), **rest))
    assert codes(statement) == [["remains_unexplained", "effects_none"], [], ["structure_found"], ["fly_structure"]]
    (error,) = statement["result"][0].values["errors"]
    assert error == {"channel": "specific_force.z", "rms_m_s2": 0.31, "floor_m_s2": 0.1}


def test_the_manoeuvre_that_decides_is_the_next_step() -> None:
    advice = Advice(fly="hover", tells=("com_offset", "weak_motor"), score=9.0, hover=1.0)
    statement = answer_parts(verdict("ambiguous", effects=(TIED,), manoeuvre=advice))
    assert statement["next"] == (Finding("fly", "hover", {"tells": ["com_offset", "weak_motor"]}),)


def test_a_parameter_that_may_be_another_effect_is_not_stated_as_found() -> None:
    rival = ParameterRival(effect="com_offset", parameter="x", other="motor_tilt", params={}, log_odds=0.1)
    effect = make_named_effect(in_part=(rival,))
    assert "x_m" not in effect.finding.values
    assert "y_m" in effect.finding.values
    assert "parameter_tied" in [one.code for one in answer_parts(verdict("explained", effects=(effect,)))["open"]]
