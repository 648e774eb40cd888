"""Changes against campaigns: blocks of flights under equal conditions, which all vehicles of a fleet fly."""

import numpy as np
import pytest

from aerial_gym.fleet.statistics import (
    ChangeResult,
    VehicleFlights,
    benjamini_hochberg,
    campaign_evidence,
    exclude_campaigns,
    find_change,
    fit_fleet,
)
from aerial_gym.sim2real.arrays import Array, Flags
from tests.unit.fleet.statistics.synthetic import make_columns, make_flights, make_model, step

MODEL = make_model(4, flight=0.03)
COLUMNS = make_columns(("weak_motor", "scale", 1), ("weak_motor", "scale", 2), "torque_ratio", tolerances=1)
FLIGHTS = 30
ROTOR = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("vehicles", [40, pytest.param(180, marks=pytest.mark.slow)])
@pytest.mark.parametrize("block", [1, 5, 10, 15])
def test_campaigns_are_no_changes(block: int, vehicles: int) -> None:
    """Blocks deviate by 3.3 times the scatter of flights; without the comparison, blocks of 15 give false alarms."""
    results = _judge(_fleet(block, vehicles))
    assert not _rejections(results).any()
    if block == 15:
        assert benjamini_hochberg(np.array([one.log_e for one in results]), 0.01).sum() > vehicles // 20


@pytest.mark.parametrize(("block", "size"), [(1, 0.8), (5, 1.5), (10, 2.5), (15, 1.5)])
def test_change_beyond_the_campaigns_is_found(block: int, size: float) -> None:
    fleet = _fleet(block, 40, changed=3, size=size)
    np.testing.assert_array_equal(_rejections(_judge(fleet)), np.arange(40) < 3)


def test_change_as_large_as_the_campaigns_is_not_told_apart() -> None:
    """Evident in itself, but steps of two campaign deviations are common in the fleet."""
    results = _judge(_fleet(15, 40, changed=1, size=0.2))
    assert results[0].log_e > np.log(1e4)
    assert not _rejections(results)[0]


def test_changed_vehicles_define_no_campaign() -> None:
    """A tenth of the vehicles change by the same cause; the other ones show that this is not common."""
    results = _judge(_fleet(1, 40, changed=4, size=0.8))
    np.testing.assert_array_equal(_rejections(results), np.arange(40) < 4)


@pytest.mark.parametrize(("vehicles", "is_found"), [(1, False), (3, False), (8, True)])
def test_other_vehicles_rule_campaigns_out(vehicles: int, is_found: bool) -> None:
    """A step of 30 times the scatter: it takes about eight vehicles."""
    results = _judge(_fleet(1, vehicles, changed=1, size=3.0))
    assert results[0].log_e > np.log(1e4)
    assert _rejections(results)[0] == is_found


def test_mean_of_the_evidence_is_one_under_campaigns() -> None:
    """Over 150 vehicles that all step by a normal size, e-values have a mean of at most 1 within three standard errors."""
    rng = np.random.default_rng(3)
    fleet = [
        make_flights(rng, MODEL, 10, change=step(10, int(rng.integers(1, 10)), 0.3 * rng.standard_normal() * ROTOR))
        for _ in range(150)
    ]
    results = [find_change(MODEL, one, COLUMNS) for one in fleet]
    values = np.exp(_log_e(results))
    assert values.mean() < 1.0 + 3.0 * values.std() / np.sqrt(150.0)
    assert np.mean(np.exp([one.log_e for one in results])) > 100.0


def _fleet(block: int, vehicles: int, changed: int = 0, size: float = 0.0) -> list[VehicleFlights]:
    """Return vehicles in blocks with a deviation of 0.1 scale; rotor 1 of the first ones steps at flight 12."""
    rng, fleet = np.random.default_rng(block), []
    for vehicle in range(vehicles):
        change = np.repeat(0.1 * rng.standard_normal((FLIGHTS // block, 4)), block, axis=0)
        change += (vehicle < changed) * step(FLIGHTS, 12, size * ROTOR)
        fleet.append(make_flights(rng, MODEL, FLIGHTS, change=change, vehicle=f"v{vehicle}"))
    return fleet


def _judge(fleet: list[VehicleFlights]) -> list[ChangeResult]:
    model = fit_fleet(fleet, COLUMNS)
    return [find_change(model, one, COLUMNS) for one in fleet]


def _log_e(results: list[ChangeResult]) -> Array:
    fleet = campaign_evidence(results)
    return np.array([exclude_campaigns(one, fleet).log_e for one in results])


def _rejections(results: list[ChangeResult]) -> Flags:
    return benjamini_hochberg(_log_e(results), 0.01)
