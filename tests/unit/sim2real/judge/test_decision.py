"""The decision of a verdict: its kind, its candidates, and the codes of what remains or stays open."""

import pytest

from aerial_gym.sim2real.judge.decision import Decision, verdict_decision

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


@pytest.mark.parametrize(
    ("effects", "remains", "kind", "expected"),
    [
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
    ],
)
def test_kind_and_open_points_follow_from_what_remains(effects, remains, kind, expected) -> None:
    given = {"unexplained": (), "floor_known": True} | remains
    decision = verdict_decision(dict.fromkeys(effects, ()), **given)
    assert (decision.kind, codes(decision)) == (kind, expected)
    assert decision.candidates == (*effects, *given.get("open_to", ()))
