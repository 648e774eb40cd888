"""The logs of the synthetic fleet."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.logs.flights import load_flights
from benchmarks.fleet.flights import FleetCmd, fly_vehicle, parameters_of_cause, plan_fleet, share_of_cause

SMALL = FleetCmd(out=Path("unused"), vehicles=40, flights=8, duration_s=4.0, changed=0.25, seed=7)


def test_causes_and_kinds_take_turns_on_the_asked_share_of_vehicles() -> None:
    plans = plan_fleet(SMALL)
    changed = [plan for plan in plans if plan.cause]
    assert len(changed) == 10
    assert len({(plan.cause, plan.kind) for plan in changed}) == 10
    assert all(3 <= plan.onset <= 6 for plan in changed)
    assert plan_fleet(SMALL) == plans


def test_a_drift_grows_to_its_final_size_and_a_step_has_it_at_once() -> None:
    step = replace(plan_fleet(SMALL)[0], cause="weak_motor", kind="step", onset=3)
    drift = replace(step, kind="drift")
    assert [share_of_cause(step, k, 4) for k in range(1, 5)] == [0.0, 0.0, 1.0, 1.0]
    assert [share_of_cause(drift, k, 4) for k in range(1, 5)] == [0.0, 0.0, 0.5, 1.0]
    whole, half = (parameters_of_cause(drift, "moderate", share)["weak_motor"] for share in (1.0, 0.5))
    assert half["motor"] == whole["motor"]
    assert 1.0 - half["scale"] == pytest.approx(0.5 * (1.0 - whole["scale"]))
    assert parameters_of_cause(drift, "moderate", 0.0) == {}


@pytest.mark.usefixtures("coarser_plant")
def test_a_weak_rotor_turns_faster_since_its_onset(tmp_path: Path) -> None:
    fleet = replace(SMALL, out=tmp_path, flights=3, size="large")
    plan = replace(plan_fleet(SMALL)[0], cause="weak_motor", kind="step", onset=3)
    fly_vehicle(plan, fleet)
    logs = sorted((tmp_path / plan.name).iterdir())
    assert [path.name for path in logs] == ["flight_0001.ulg", "flight_0002.ulg", "flight_0003.ulg"]
    flights = load_flights([str(path) for path in logs], robot_by_name("base_quadrotor"), mapping=None, bandwidth=10.0)
    shares = np.stack([flight.rotor_speed.mean(axis=0) / flight.rotor_speed.mean() for flight in flights])
    weak = int(parameters_of_cause(plan, "large", 1.0)["weak_motor"]["motor"]) - 1
    assert (shares[2] - shares[:2].mean(axis=0)).argmax() == weak
    assert shares[2, weak] - shares[:2, weak].max() > 0.02
