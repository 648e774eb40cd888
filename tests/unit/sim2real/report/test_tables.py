"""The headline of a report: how sure each effect is, and what became of each channel."""

import numpy as np

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.report.tables import channels_by_outcome, reason_rows, rejection_rows, text_rows_of_effects
from aerial_gym.sim2real.statistics import Rise
from aerial_gym.sim2real.wording import text
from tests.unit.sim2real.judge.builders import make_named_effect, make_outcome, make_verdict
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection


def test_every_channel_is_told_once_with_what_became_of_it() -> None:
    changes = (
        ("specific_force.x", -0.51, -0.6, -0.4),
        ("specific_force.y", 0.0, -0.01, 0.01),
        ("specific_force.z", 0.2, 0.1, 0.3),
        ("rotor_speed.1", -0.87, -0.9, -0.8),
        ("rotor_speed.2", -0.86, -0.9, -0.8),
        ("angular_acceleration.x", 0.1, -0.1, 0.4),
        ("free.velocity", 0.5, 0.4, 0.6, 1.0),  # no channel
    )
    rows = channels_by_outcome(make_verdict(outcomes=tuple(make_outcome(*change) for change in changes)))
    assert list(rows.items()) == [
        ("worse", "specific force z (+20%)"),
        ("better", "specific force x (-51%); rotor speed 1 (-87%), 2 (-86%)"),
        ("same", "specific force y"),
        ("not shown", "angular acceleration x (+10%)"),
    ]


def test_every_effect_says_how_sure_it_is() -> None:
    offset = make_named_effect(
        params={"x": 0.004, "y": -0.002, "z": 0.0}, std={"x": 1e-4, "y": 2e-4}, frozen=("z",), confidence=0.98,
        ties=("motor_tilt",),
    )  # fmt: skip
    gusts = make_named_effect("gusts", params={"std": 0.5}, std={}, confidence=0.999)
    rows = text_rows_of_effects(make_verdict(effects=(offset, gusts)))
    assert rows[0]["parameters"] == "x = 0.004 ± 0.0002 m, y = -0.002 ± 0.00039 m"
    assert rows[0]["sure"] == "confidence 0.98, may as well be motor_tilt"
    assert rows[1] == {"name": "gusts", "parameters": "std = 0.5 m/s", "sure": "confidence 0.999"}


def test_names_that_share_a_reason_share_a_line() -> None:
    reasons = {"a": "no position", "b": "no voltage", "c": "no position"}
    assert reason_rows(reasons) == {"no position": ["a", "c"], "no voltage": ["b"]}


def test_every_effect_that_is_not_named_has_a_reason() -> None:
    rise = Rise(value=0.01, low=0.0, high=0.02)
    adds = {"rotor_drag": 50.0, "com_offset": 1.24, "payload_mass": -3.0, "weak_motor": 9.0}
    chosen = make_choice(
        make_fit("rotor_drag", log=0.0),
        make_fit("rotor_drag", "com_offset", log=float(np.log(0.25))),
        adds=adds | {"motor_tilt": 5.0, "imu_bias": -1.0},
        surrogates={"weak_motor": "time"},
        immaterial={"motor_tilt": {"specific_force.x": rise}},
        refused={"imu_bias": Finding("at_bound", "imu_bias", {"parameters": ["ax"]})},
    )
    rows = rejection_rows(make_selection(chosen, not_testable={"downwash": Finding("acts_on_links", "downwash")}))
    assert [(row["effect"], row["log_odds"], row["probability"]) for row in rows] == [
        ("weak_motor", "9.0", "–"),
        ("motor_tilt", "5.0", "–"),
        ("com_offset", "1.2", "0.2"),
        ("imu_bias", "-1.0", "–"),
        ("payload_mass", "-3.0", "–"),
        ("downwash", "–", "–"),
    ]
    expected = [
        Finding("follows_structure", "weak_motor", {"structure": "time"}),
        Finding("trifle", "motor_tilt", {"rise": 0.02}),
        Finding("only_linear", "com_offset"),
        Finding("at_bound", "imu_bias", {"parameters": ["ax"]}),
        Finding("less_probable", "payload_mass"),
        Finding("acts_on_links", "downwash"),
    ]
    assert [row["because"] for row in rows] == [text(finding) for finding in expected]
