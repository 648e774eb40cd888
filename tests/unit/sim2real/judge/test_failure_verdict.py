"""A failure that not every flight has is told with what would train with it."""

from dataclasses import replace

import pytest

from aerial_gym.sim2real.failures.flight_event import Failure
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge import failure_verdict
from aerial_gym.sim2real.judge.analysis import LoopResult
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.judge.builders import make_setup, make_verdict
from tests.unit.sim2real.set_fits import make_selection

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


@pytest.mark.parametrize(
    ("name", "params", "trains"),
    [
        ("motor_failure", {"motor": 2.0, "scale": 0.5, "time": 3.0}, {"motor": 2.0, "scale": 0.5, "time": 3.0}),
        # A propeller that gives 0.81 of its thrust, as at 0.9 of its speed: the effect has no onset.
        ("weak_motor", {"motor": 1.0, "scale": 0.81, "time": 4.0}, {"motor": 1.0, "scale": 0.9, "time": 4.0}),
    ],
)
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
