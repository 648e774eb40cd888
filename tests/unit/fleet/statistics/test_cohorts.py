"""Differences between firmware versions."""

from dataclasses import replace

import numpy as np

from aerial_gym.fleet.statistics import FleetModel, VehicleFlights, compare_cohorts
from aerial_gym.fleet.statistics.scan import SIZES
from tests.unit.fleet.statistics.synthetic import make_columns, make_flights, make_model, step

COLUMNS = make_columns("weak_motor", "torque_ratio", tolerances=1)
MODEL = make_model(3, mean=0.2)
PLAIN = np.array([1.0, 0.0, 0.0])


def _with_update(flights: VehicleFlights, onset: int) -> VehicleFlights:
    return replace(flights, firmware=("A",) * onset + ("B",) * (len(flights.firmware) - onset))


def _fleet(seed: int, size: float, vehicles: int = 10, model: FleetModel = MODEL) -> list[VehicleFlights]:
    rng = np.random.default_rng(seed)
    own = [make_flights(rng, model, 8, change=step(8, 5, size * PLAIN), vehicle=f"v{k}") for k in range(vehicles)]
    return [_with_update(one, 5) for one in own]


def test_difference_within_vehicles() -> None:
    """Ten vehicles flew both: sign, size, interval and cause, with the less flown version second."""
    for size in (-0.2, 0.2):
        first, second = compare_cohorts(MODEL, _fleet(0, size), COLUMNS)
        assert (first.firmware, first.effect, first.rejected, first.leading) == (("A", "B"), "weak_motor", True, True)
        assert first.low[0] < 0.05 * size < first.high[0]
        assert first.high[0] - first.low[0] < 0.004
        assert (first.flights, first.vehicles, first.vehicles_of_both) == ((50, 30), (10, 10), 10)
        assert not second.rejected
        assert not second.leading


def test_difference_between_vehicles_alone() -> None:
    """One column, exact flights, m and n vehicles: the means differ with variance ``V (1/m + 1/n)``, m of prior N(0, 1)."""
    values, model = {"A": [0.1, 0.5, 0.3, 0.2], "B": [0.9, 1.0]}, make_model(1, mean=0.2, flight=1e-4)
    fleet = [
        VehicleFlights(
            vehicle=f"{name}{k}", product=np.full((1, 1, 1), 1e8), gradient=np.full((1, 1), 1e8 * value),
            time=np.zeros(1), firmware=(name,),
        )
        for name, own in values.items()
        for k, value in enumerate(own)
    ]  # fmt: skip
    (row,) = compare_cohorts(model, fleet, COLUMNS[:1])
    mean_var = 1.0 / (1.0 + 4.0 / 0.09)
    difference, variance = 0.95 - mean_var * sum(values["A"]) / 0.09, mean_var + 0.045
    prior = np.square(SIZES)
    weight = np.exp(-0.5 * difference**2 / (variance + prior)) / np.sqrt(variance + prior)
    expected = (weight / weight.sum()) @ (prior / (prior + variance)) * difference
    np.testing.assert_allclose(row.difference, 0.05 * expected, rtol=1e-3)
    assert row.vehicles_of_both == 0


def test_equal_versions_are_not_told_apart() -> None:
    """Among 30 fleets without a difference, none is rejected, and 95 % of the intervals hold zero."""
    rows = [row for seed in range(1, 31) for row in compare_cohorts(MODEL, _fleet(seed, 0.0, vehicles=5), COLUMNS)]
    assert not any(row.rejected for row in rows)
    inside = np.mean([row.low[0] < 0.0 < row.high[0] for row in rows])
    assert inside >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / len(rows))


def test_no_difference_rests_on_few_vehicles() -> None:
    """A step of one vehicle at its update is no difference of firmware, nor is one that two vehicles flew alone."""
    same, changed = _fleet(42, 0.0), _fleet(43, 1.0)
    assert not any(row.rejected for row in compare_cohorts(MODEL, [changed[0], *same[1:]], COLUMNS))
    plain = [replace(one, firmware=("A",) * 8) for one in same[2:]]
    rows = compare_cohorts(MODEL, [*changed[:2], *plain], COLUMNS)
    assert not any(row.rejected for row in rows)
    assert compare_cohorts(MODEL, changed[:3], COLUMNS)[0].rejected


def test_deviations_of_vehicles_cancel() -> None:
    """A vehicle that deviates by 20 standard deviations, and flew both versions, shows no difference."""
    flights = make_flights(np.random.default_rng(40), MODEL, 8, deviation=6.0 * PLAIN)
    rows = compare_cohorts(make_model(3, mean=0.2, vehicle=5.0), [_with_update(flights, 4)], COLUMNS)
    assert max(row.log_e for row in rows) < 0.0


def test_unknown_and_single_versions() -> None:
    flights = make_flights(np.random.default_rng(41), MODEL, 4)
    assert compare_cohorts(MODEL, [flights, replace(flights, firmware=("",) * 4)], COLUMNS) == []
    assert compare_cohorts(MODEL, [], COLUMNS) == []
    three = [replace(flights, firmware=("A", "A", "B", "")), replace(flights, firmware=("A", "C", "C", "C"))]
    assert {row.firmware for row in compare_cohorts(MODEL, three, COLUMNS)} == {("A", "B"), ("A", "C")}
