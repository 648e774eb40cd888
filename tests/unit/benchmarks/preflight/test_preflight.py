"""Faults of the preflight benchmark, and its judge."""

import json

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.preflight.check import Preflight, preflight
from aerial_gym.sim2real.preflight.link import TrainingLink
from aerial_gym.sim2real.preflight.ranges import TrainingConditions
from aerial_gym.sim2real.preflight.result_file import read_result
from benchmarks.preflight.faults import DRAWS, POLICY_HZ, Fault, draw_fault
from benchmarks.preflight.flights import LinkPilot, fly_vehicle
from benchmarks.preflight.score import EXPECTED, judge
from benchmarks.undeclared.vehicle import DECLARED


def test_every_kind_of_fault_has_expected_names() -> None:
    assert DRAWS.keys() == EXPECTED.keys()


def test_a_fault_changes_one_place() -> None:
    """Vehicle, link, robot file or log: exactly one of them differs for each kind."""

    def document() -> dict:
        return {"battery": {"nominal_voltage": 16.0}, "mounts": {"layout": [{"spin": 1, "rotor": k} for k in range(4)]}}

    names = ("omega_x", "omega_y", "omega_z", "acc_x", "acc_y", "acc_z", "vbat")
    for kind in DRAWS:
        fault, columns = draw_fault(kind, 3), {name: np.ones(2) for name in names}
        fault.log(columns)
        places = [
            fault.vehicle(DECLARED) is not DECLARED,
            fault.link() != Fault().link(),
            fault.robot(document()) != document(),
            any((column != 1.0).any() for column in columns.values()),
        ]
        assert sum(places) == (0 if kind == "state_latency" else 1), kind  # which the sensors have


def test_link_keeps_order_and_loses_its_share() -> None:
    pilot = LinkPilot(DECLARED, draw_fault("link", 0).link(), 4000, 2, seed=0)
    assert (np.diff(pilot._arrival, axis=0) >= 1).all()
    assert pilot.jitter == pytest.approx(0.01, rel=0.1)
    lossy = LinkPilot(DECLARED, draw_fault("packet_loss", 0).link(), 40_000, 2, seed=0)
    assert lossy.lost.mean() == pytest.approx(0.05, rel=0.1)


def preflight_result(*findings: Finding) -> Preflight:
    return Preflight(robot="r.yaml", log="a.csv", findings=findings)


def test_judge_asks_for_the_name_the_number_and_nothing_else() -> None:
    truth = {
        "kind": "command_latency", "values": {"delay": 0.02}, "thrust_per_weight": 1.0, "acc_scale": 1.0, "jitter_s": 0.0,
        "loss": 0.0, "link": {"rate": 100.0}, "delay_s": dict.fromkeys(("rotor", "acc", "rate", "rotation", "velocity"), 0.0),
    }  # fmt: skip

    def latency(value: float) -> Finding:
        return Finding(
            "constant_contradicted", "command_latency", {"value": value, "low": value - 0.003, "high": value}
        )

    assert judge(preflight_result(latency(0.024)), truth)["right"]
    assert judge(preflight_result(latency(0.024)), truth)["intervals"] == [0, 1]
    assert json.loads(json.dumps(judge(preflight_result(latency(np.float64(0.022))), truth)))["intervals"] == [1, 1]
    assert not judge(preflight_result(latency(0.026)), truth)["right"]
    assert not judge(preflight_result(), truth)["right"]
    assert not judge(preflight_result(latency(0.02), Finding("gyro_sign_contradicted", "x")), truth)["right"]
    assert judge(preflight_result(), truth | {"kind": ""})["right"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["", "gyro_sign", "rotor_order", "thrust", "command_latency"])
def test_fault_of_a_flown_vehicle(kind: str, tmp_path) -> None:
    """The fault is named with its number, nothing else is, and the written result is read back."""
    files = fly_vehicle(tmp_path, kind, 41)
    result = preflight(files.robot, files.log, training=TrainingConditions(link=TrainingLink(rate=POLICY_HZ)))
    assert judge(result, json.loads(files.truth.read_text()))["right"]
    result.write(tmp_path / "result.json")
    assert read_result(tmp_path / "result.json")["verdict"] == ("contradicted" if kind else "ready")
