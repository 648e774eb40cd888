"""A failure that not every flight has is told with what would train with it."""

from types import SimpleNamespace

import pytest

from aerial_gym.sim2real.judge import failed
from aerial_gym.sim2real.judge.verdict import Verdict


@pytest.mark.parametrize(
    ("name", "params", "line"),
    [
        ("motor_failure", {"motor": 2.0, "scale": 0.5, "time": 3.0}, "motor_failure: {motor: 2, scale: 0.5, time: 3}"),
        # A propeller that gives 0.81 of its thrust, as at 0.9 of its speed: the effect has no onset.
        ("weak_motor", {"motor": 1.0, "scale": 0.81, "time": 4.0}, "motor_failure: {motor: 1, scale: 0.9, time: 4}"),
    ],
)
def test_a_failure_of_one_flight_is_told_with_the_line_that_trains_with_it(
    monkeypatch: pytest.MonkeyPatch, name: str, params: dict[str, float], line: str
) -> None:
    found = SimpleNamespace(name=name, params=params, flight="f1", time=params["time"], sentence="rotor fails")
    note = failed._how_to_train(found)  # type: ignore[arg-type]
    assert note.startswith("f1 is compared up to its failure; that is not in robot.yaml, for not every flight has it: ")
    assert note.endswith(f"add to effects: {line}")
    before = SimpleNamespace(
        verdict="none", effects=(), candidates=(), notes=("other",), reason="nothing", outcomes=(), failures=()
    )
    before.told_before = lambda told: Verdict.told_before(before, told)  # type: ignore[arg-type]
    monkeypatch.setattr(failed, "replace", lambda one, **changes: SimpleNamespace(**(vars(one) | changes)))
    told = failed._told(before, [found], None)  # type: ignore[arg-type]
    assert told.notes == (note, "other")
    assert told.reason == "rotor fails; up to then: nothing"
    assert told.verdict == "explained"


def test_what_looks_like_a_failure_is_noted_and_changes_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without --failures: one note more, with the flight and the odds; without a suspicion what was judged itself."""
    found = SimpleNamespace(flight="f1", sentence="f1: rotor 2 follows half", log_odds=24.81)
    judged = SimpleNamespace(verdict=SimpleNamespace(verdict="none", notes=("other",)), corrected="robot")
    monkeypatch.setattr(failed, "replace", lambda one, **changes: SimpleNamespace(**(vars(one) | changes)))
    told = failed.with_suspicions(judged, [found])  # type: ignore[arg-type]
    assert (told.corrected, told.verdict.verdict, told.verdict.notes[0]) == ("robot", "none", "other")
    assert told.verdict.notes[1].startswith(
        "f1: rotor 2 follows half: so it looks beside the declared vehicle (log odds 24.8)"
    )
    assert "--failures compares f1 up to there" in told.verdict.notes[1]
    assert failed.with_suspicions(judged, []) is judged  # type: ignore[arg-type]
