"""What is made of failures: flights up to them, one that all flights have, words."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.failures.flight_event import (
    Failure,
    FailureFinder,
    cut_at_failures,
    failure_of_all_flights,
    least_log_odds,
)
from aerial_gym.sim2real.failures.scan import _lag_response
from tests.unit.sim2real.failures.test_evidence import make_work
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.predict.test_scene import hover


def failure(flight: str, time: float = 5.0, **params: float) -> Failure:
    values = {"motor": 2.0, "scale": 0.8, "time": time} | params
    half_widths = {"scale": 0.01, "time": 0.02}
    return Failure(
        flight=flight,
        name="motor_failure",
        params=values,
        std={"scale": 0.005, "time": 0.01},
        interval={name: (values[name] - size, values[name] + size) for name, size in half_widths.items()},
        log_odds=100.0,
        probability=1.0,
        rival="",
    )


def test_flights_end_before_their_failures_or_are_left_out() -> None:
    """A failure known to 20 ms at 3 s leaves 2.98 s; one at 1 s leaves less than 2 s, and so nothing."""
    flights = [hover(name, 1.0, rotor_command=np.ones((400, 4))) for name in "abc"]
    event = cut_at_failures(flights, [failure("b", 3.0), failure("c", 1.0)])
    assert [(one.name, one.num_rows) for one in event] == [("a", 400), ("b", 298)]
    assert event[1].attitude.shape == event[1].rotor_command.shape == (298, 4)


def test_one_failure_is_that_of_all_flights_only_if_it_is_the_same_in_all() -> None:
    both = [failure("a", 5.00), failure("b", 5.02)]
    every = failure_of_all_flights(both, 2)
    assert every.params == pytest.approx({"motor": 2.0, "scale": 0.8, "time": 5.01})
    assert every.std["time"] == pytest.approx(0.01 / np.sqrt(2.0))
    different_failures = (failure("b", 5.1), failure("b", 5.0, scale=0.7), failure("b", 5.0, motor=3.0))
    for other in (*different_failures, replace(both[1], name="weak_motor")):
        assert failure_of_all_flights([both[0], other], 2) is None
    assert failure_of_all_flights(both, 3) is None


def test_a_failure_is_a_finding_with_its_intervals() -> None:
    event = replace(failure("a"), place="front left").finding
    assert (event.code, event.subject) == ("failure_found", "a")
    times = {"time_s": 5.0, "time_low_s": 4.98, "time_high_s": 5.02}
    shares = {"share": 0.8, "share_low": 0.79, "share_high": 0.81}
    names = {"failure": "motor_failure", "rotor": 2, "place": "front left"}
    assert event.values == pytest.approx(times | shares | names)


def test_the_limit_is_that_of_blocks_between_false_alarms() -> None:
    """100 h of blocks of 0.1 s: 3.6 million."""
    assert np.exp(least_log_odds(100.0)) == pytest.approx(3.6e6)
    with pytest.raises(ConfigError, match="must be > 0"):
        FailureFinder(ROBOT, false_alarm_hours=0.0)


def test_a_change_rises_in_blocks_as_the_lag_lets_it() -> None:
    """The mean over a block of ``1 - exp(-(t - t0) / lag)``, by a sum over 10,000 instants."""
    work, begin = make_work(1), np.array([0.53, 0.6])
    at = work.time[:, None] + work.length * (np.arange(10000) + 0.5) / 10000
    for row, start in enumerate(begin):
        since = np.clip(at - start, 0.0, None)
        expected = (1.0 - np.exp(-since / work.lag)).mean(axis=1)
        np.testing.assert_allclose(_lag_response(work, begin)[row], expected, atol=1e-7)
