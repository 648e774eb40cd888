"""A failure that not every flight has is told with what would train with it."""

from types import SimpleNamespace

import pytest

from aerial_gym.sim2real.judge import failure_verdict


@pytest.mark.parametrize(
    ("name", "params", "trains"),
    [
        ("motor_failure", {"motor": 2.0, "scale": 0.5, "time": 3.0}, {"motor": 2.0, "scale": 0.5, "time": 3.0}),
        # A propeller that gives 0.81 of its thrust, as at 0.9 of its speed: the effect has no onset.
        ("weak_motor", {"motor": 1.0, "scale": 0.81, "time": 4.0}, {"motor": 1.0, "scale": 0.9, "time": 4.0}),
    ],
)
def test_a_failure_of_one_flight_is_noted_with_the_effect_that_trains_with_it(
    monkeypatch: pytest.MonkeyPatch, name: str, params: dict[str, float], trains: dict[str, float]
) -> None:
    result = SimpleNamespace(name=name, params=params, flight="f1", time=params["time"])
    note = failure_verdict._training_advice(result)
    assert (note.code, note.subject, note.values["effect"]) == ("train_with_failure", "f1", "motor_failure")
    assert note.values["params"] == pytest.approx(trains)
    before = SimpleNamespace(verdict="none", effects=(), candidates=(), notes=("other",), failures=())
    monkeypatch.setattr(failure_verdict, "replace", lambda one, **changes: SimpleNamespace(**(vars(one) | changes)))
    told = failure_verdict._add_failures(before, [result], None)
    assert told.notes == (note, "other")
    assert (told.verdict, told.failures) == ("explained", (result,))


def test_what_looks_like_a_failure_is_noted_and_changes_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    event = SimpleNamespace(values={"failure": "motor_failure"})
    result = SimpleNamespace(flight="f1", finding=event, log_odds=24.81)
    judged = SimpleNamespace(verdict=SimpleNamespace(verdict="none", notes=("other",)), corrected="robot")
    monkeypatch.setattr(failure_verdict, "replace", lambda one, **changes: SimpleNamespace(**(vars(one) | changes)))
    told = failure_verdict.with_suspicions(judged, [result])
    assert (told.corrected, told.verdict.verdict, told.verdict.notes[0]) == ("robot", "none", "other")
    note = told.verdict.notes[1]
    assert (note.code, note.subject, note.values["log_odds"]) == ("failure_suspected", "f1", 24.81)
    assert failure_verdict.with_suspicions(judged, []) is judged
