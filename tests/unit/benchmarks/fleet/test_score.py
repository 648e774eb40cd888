"""The scores of fleet analysis on a synthetic fleet."""

import json

import pytest

from benchmarks.fleet.score import score_fleet
from benchmarks.undeclared.effects import effect_parameters
from benchmarks.undeclared.vehicle import DECLARED


def verdict(vehicle: str, *causes: tuple[str, int], onset: int = 5, rejected: bool = True) -> dict[str, object]:
    listed = [{"effect": effect, "rotor": rotor, "candidate": True} for effect, rotor in causes]
    listed.append({"effect": "com_offset", "rotor": 0, "candidate": False})
    kind = "ambiguous" if len(causes) > 1 else "changed" if causes else "no_change"
    return {
        "vehicle": vehicle,
        "verdict": kind,
        "causes": json.dumps(listed),
        "rejected": rejected,
        "onset_flight": onset,
    }


def test_only_the_right_cause_and_rotor_count_as_found() -> None:
    weak, moved = ({"cause": cause, "seed": 3, "onset": 6} for cause in ("weak_motor", "com_offset"))
    rotor = int(effect_parameters({"weak_motor": "moderate"}, declared=DECLARED, seed=3)["weak_motor"]["motor"])
    truth = {"changed": {"a": weak, "b": weak, "c": moved, "d": moved, "e": moved}}
    verdicts = [
        verdict("a", ("weak_motor", rotor), onset=5),
        verdict("b", ("weak_motor", rotor % 4 + 1)),
        verdict("c", ("imu_bias", 0), ("com_offset", 0), onset=9),
        verdict("d", ("imu_bias", 0)),
        verdict("e", ("com_offset", 0), rejected=False),
        verdict("f", ("com_offset", 0)),
        verdict("g"),
    ]
    verdicts[-1]["rejected"] = False
    score = score_fleet(truth, verdicts, "moderate")
    assert (score.vehicles, score.changed, score.num_found, score.reported, score.false) == (7, 5, 2, 5, 3)
    assert score.ambiguous == 1
    assert score.onset_errors == (-1, 3)
    assert score.recall == pytest.approx(0.4)
    assert score.false_discovery == pytest.approx(0.6)
    assert score.median_onset_error == pytest.approx(2.0)


def test_a_fleet_without_reports_has_no_false_ones() -> None:
    score = score_fleet({"changed": {}}, [verdict("a", rejected=False)], "moderate")
    assert (score.recall, score.false_discovery) == (1.0, 0.0)
