"""The judgement of failures and jumps against what was hidden, and its tables."""

import numpy as np

from aerial_gym.sim2real.logs.recording import FlightLog
from benchmarks.scores.score_failures import failure_tables, score_finding
from benchmarks.scores.score_jumps import jumps_streamed, stops_streamed
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
    lines = failure_tables(fails, silent).splitlines()
    assert lines[2] == "| `motor_failure` | 1 of 2 | 1 | 2.49 (2.49) | 2.49 (2.49) | 1 of 2 |"
    assert lines[6] == "| `motor_failure` | 0.005, 0.005 | 1 of 1 | 10, 10 | 1 of 1 |"
    assert lines[-2] == "| nothing hidden | 0.50 | none | none |"
    assert lines[-1] == "| one of 1 large effects hidden | 0.25 | weak_motor (gusts) | none |"


def swing(seconds: float = 16.0, rate: float = 100.0) -> FlightLog:
    """Return a flight with noise of 1 mm and 1 mm/s that swings about a place."""
    rng, time = np.random.default_rng(0), np.arange(round(seconds * rate)) / rate
    way, speed = np.sin(time)[:, None] * (1.0, 0.5, 0.2), np.cos(time)[:, None] * (1.0, 0.5, 0.2)
    return FlightLog(
        path="swing",
        time=time,
        attitude=np.stack((np.sin(0.1 * np.sin(time)), 0.0 * time, 0.0 * time, np.cos(0.1 * np.sin(time))), axis=1),
        position=way + 1e-3 * rng.standard_normal((time.size, 3)),
        lin_vel=speed + 1e-3 * rng.standard_normal((time.size, 3)),
    )


def test_jumps_and_stops_of_a_quiet_flight_are_told_in_time() -> None:
    """A fix that moves by 1 m and returns, known to the noise of half seconds; a position that repeats itself."""
    jumps = jumps_streamed([swing()], 1.0, np.random.default_rng(1))
    assert (jumps.flights, jumps.complete, jumps.soon, jumps.false) == (1, 1, 1, 0)
    assert len(jumps.errors) == 2
    assert max(jumps.errors) < 5e-3
    stays = jumps_streamed([swing()], 1.0, np.random.default_rng(1), returns=False)
    assert (stays.complete, stays.soon, stays.false) == (1, 1, 0)
    assert len(stays.errors) == 1
    stops = stops_streamed([swing()], "position", np.random.default_rng(1))
    assert (stops.complete, stops.soon, stops.false) == (1, 1, 0)
    assert stops_streamed([swing()], "specific_force", np.random.default_rng(1)).flights == 0
