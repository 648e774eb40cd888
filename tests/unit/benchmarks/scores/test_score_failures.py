"""The judgement of findings against what was hidden, and the tables of it."""

from dataclasses import replace

import numpy as np

from benchmarks.scores.score_failures import KINDS, SIZES, draw_failure, score_finding, tables
from benchmarks.undeclared import PlantFailure
from tests.unit.sim2real.failures.test_flight_event import failure

HIDDEN = PlantFailure(kind="motor_failure", motor=2, scale=0.805, time=5.01)


def test_a_finding_is_right_if_name_and_rotor_are() -> None:
    row = score_finding(failure("a"), HIDDEN, told=7.5)
    assert row["right"]
    assert row["inside"] == {"time": True, "scale": True}
    assert row["delay_s"] == 7.5 - 5.01
    assert not score_finding(failure("a", motor=3.0), HIDDEN)["right"]
    assert not score_finding(failure("a"), PlantFailure(kind="weak_motor", motor=2, scale=0.8, time=5.0))["right"]
    assert score_finding(failure("a", time=5.2), HIDDEN)["inside"] == {"time": False, "scale": True}


def test_drawn_failures_are_those_of_their_seed_and_within_their_ranges() -> None:
    for kind in KINDS:
        one, same = (draw_failure(kind, np.random.default_rng(4)) for _ in range(2))
        assert one == same
        assert SIZES[kind][0] <= one.scale <= SIZES[kind][1]
        assert 4.0 <= one.time <= 8.0


def test_the_tables_count_what_is_named_and_what_is_told_of_nothing() -> None:
    right, wrong = (score_finding(failure("a", **motor), HIDDEN, told=7.5) for motor in ({}, {"motor": 3.0}))
    fails = [
        {"truth": HIDDEN.document(), "watch": {"suspected": one, "named": one}, "close_loop": loop}
        for one, loop in ((right, right), (wrong, None))
    ]
    silent = [
        {"hidden": "nothing", "hours": 0.5, "watch": [], "close_loop": []},
        {"hidden": "gusts", "hours": 0.25, "watch": [{"stage": "suspected", "name": "weak_motor"}], "close_loop": []},
    ]
    lines = tables(fails, silent).splitlines()
    assert lines[2] == "| `motor_failure` | 1 of 2 | 1 | 2.49 (2.49) | 2.49 (2.49) | 1 of 2 |"
    assert lines[6] == "| `motor_failure` | 0.005, 0.005 | 1 of 1 | 10, 10 | 1 of 1 |"
    assert lines[-2] == "| nothing hidden | 0.50 | none | none |"
    assert lines[-1] == "| one of 1 large effects hidden | 0.25 | weak_motor (gusts) | none |"


def test_a_stuck_rotor_has_its_speed_as_its_size_and_late_names_do_not_count_as_soon() -> None:
    """Speeds of 700 and 702 rad/s told of 705, one of them 11 s after the onset."""
    hidden = PlantFailure(kind="stuck_rotor", motor=2, time=5.0)
    rows = []
    for speed, told in ((700.0, 7.5), (702.0, 16.0)):
        params, ends = {"motor": 2.0, "speed": speed, "time": 5.0}, {"speed": (speed, speed + 4.0), "time": (4.9, 5.1)}
        result = replace(failure("a"), name="stuck_rotor", params=params, interval=ends)
        one = score_finding(result, hidden, told=told, speed=705.0)
        rows.append({"truth": hidden.document(), "watch": {"suspected": one, "named": one}, "close_loop": None})
    lines = tables(rows, []).splitlines()
    assert lines[2].startswith("| `stuck_rotor` | 2 of 2 | 1 |")
    assert lines[6].startswith("| `stuck_rotor` | 4, 5 rad/s | 1 of 2 |")
