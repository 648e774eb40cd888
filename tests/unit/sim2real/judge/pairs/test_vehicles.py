"""Two vehicles in the same flights: an effect that both share, and one that only one of them has."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.judge.outcome import Decision, decision_with_doubts
from aerial_gym.sim2real.judge.pairs.vehicles import verdict_with_each_vehicle
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.logs.flights import load_train_and_test
from aerial_gym.sim2real.logs.pairs import pair_logs
from aerial_gym.sim2real.loop import judge_flights
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.sim2real.judge.builders import make_named_effect, make_verdict

SECONDS = 8.0


def verdict_on_drags(folder: Path, drags: tuple[float, float]) -> Verdict:
    """Return the verdict on three training flights and a test flight of two vehicles with drag [N s/m]."""
    logs = [
        tuple(
            write(flight(40 + 2 * n + v, drag=drag, noise=1.0, seconds=SECONDS, rate=100.0), folder / f"f{n}_{v}.csv")
            for v, drag in enumerate(drags)
        )
        for n in range(4)
    ]
    train, test = [log for pair in logs[:3] for log in pair], logs[3]
    flights = load_train_and_test(ROBOT, train, test, None, 10.0, pairs=pair_logs(logs))
    return judge_flights(ROBOT, *flights, effects=("rotor_drag",), criteria=Criteria()).verdict


@pytest.mark.slow
def test_vehicles_that_are_alike_share_their_parameters(tmp_path: Path) -> None:
    verdict = verdict_on_drags(tmp_path, (0.25, 0.25))
    assert [effect.name for effect in verdict.effects] == ["rotor_drag"]
    assert verdict.verdict == "explained"
    assert "vehicle_alone" not in [point.code for point in verdict.open_points]


@pytest.mark.slow
def test_an_effect_of_one_vehicle_is_found_on_that_one(tmp_path: Path) -> None:
    verdict = verdict_on_drags(tmp_path, (0.0, 0.3))
    assert verdict.verdict == "ambiguous"
    alone = {one.subject: one.values for one in verdict.open_points if one.code == "vehicle_alone"}
    assert alone["first"]["effects"] == {}
    assert alone["second"]["verdict"] == "explained"
    (params,) = alone["second"]["effects"].values()
    assert params["dx"] == pytest.approx(0.3, abs=0.05)


def test_warnings_on_pairs_leave_no_verdict_certain() -> None:
    made = Decision(kind="explained", candidates=("downwash",), findings=())
    warning, note = Finding("clock_contradicted", "a and b"), Finding("clock_confirmed", "a and b")
    assert decision_with_doubts(made, [note]) == made
    assert decision_with_doubts(made, [note, warning]) == replace(made, kind="ambiguous", findings=(warning,))
    assert decision_with_doubts(replace(made, kind="unexplained"), [warning]).kind == "unexplained"


def test_each_vehicle_alone_decides_where_both_together_stay_unexplained() -> None:
    remains = Finding("remains_unexplained", "", {"channels": ["specific_force.x"]})
    both = make_verdict("unexplained", unexplained=("specific_force.x",), open_points=(remains,))
    quiet, named = make_verdict("none"), make_verdict("explained", effects=(make_named_effect("com_offset"),))
    one = verdict_with_each_vehicle(both, (quiet, named))
    assert (one.verdict, one.candidates) == ("ambiguous", ("com_offset",))
    assert [point.code for point in one.open_points] == ["vehicle_alone", "vehicle_alone", "remains_unexplained"]
    neither = verdict_with_each_vehicle(both, (quiet, make_verdict("not shown")))
    assert (neither.verdict, neither.unexplained) == ("not shown", ())
    assert verdict_with_each_vehicle(both, (quiet, quiet)).verdict == "none"
    assert verdict_with_each_vehicle(both, (quiet, both)).verdict == "unexplained"


def test_the_same_effects_with_the_same_values_on_both_explain_both() -> None:
    """Deviations within tolerances differ between two vehicles, so that one set of them leaves a remainder."""

    def verdict(x: float, kind: str = "explained", **more: Any) -> Verdict:
        effect = make_named_effect("downwash", params={"force": x, "sigma": 0.3}, std={"force": 0.01, "sigma": 0.01})
        return make_verdict(kind, effects=(effect,), **more)

    both = verdict(0.5, "unexplained", unexplained=("specific_force.x",))
    shared = verdict_with_each_vehicle(both, (verdict(0.49), verdict(0.51)))
    assert (shared.verdict, shared.unexplained) == ("explained", ())
    assert verdict_with_each_vehicle(both, (verdict(0.4), verdict(0.6))).verdict == "ambiguous"
    unnamed = make_verdict("unexplained", unexplained=("specific_force.x",))
    assert verdict_with_each_vehicle(unnamed, (verdict(0.49), verdict(0.51))).verdict == "ambiguous"
    doubt = Finding("clock_contradicted", "a and b", {"offset_s": 0.3, "half_width_s": 0.02})
    doubted = replace(both, open_points=(doubt,))
    assert verdict_with_each_vehicle(doubted, (verdict(0.49), verdict(0.51))).verdict == "ambiguous"
