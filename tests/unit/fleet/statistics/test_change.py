"""Changes of vehicles: size, sign, kind, onset and cause, and what is no change."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from aerial_gym.fleet.statistics import ChangeResult, VehicleFlights, benjamini_hochberg, find_change, time_to_limit
from tests.unit.fleet.statistics.synthetic import drift, make_columns, make_fleet, make_flights, make_model, step

EFFECTS = [("com_offset", "x", 0), ("com_offset", "y", 0), ("weak_motor", "scale", 1), ("weak_motor", "scale", 2)]
COLUMNS = make_columns(*EFFECTS, ("constant_wind", "x", 0), tolerances=1)
MODEL = make_model(6, flight=[0.05, 0.05, 0.05, 0.05, 3.0, 0.05])
THRUST = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])  # of rotor 2
CLEAR = np.log(1000.0)


@pytest.mark.parametrize("size", [-0.42, 0.42])
@pytest.mark.parametrize(("kind", "pattern"), [("step", step), ("drift", drift)])
def test_change_of_one_rotor(kind: str, pattern: Any, size: float) -> None:
    """A thrust of -2.1 % or +2.1 % since flight 8 of 20: sign, size, kind, rotor and onset."""
    result = _find(1, 20, change=pattern(20, 8, size * THRUST))
    best = result.causes[0]
    assert result.log_e > CLEAR
    assert result.candidates == (best,)
    assert result.odd_flights == ()
    assert (best.effect, best.rotor, best.kind, best.parameters) == ("weak_motor", 2, kind, ("scale",))
    assert best.onset_low <= 8 <= best.onset_high
    assert abs(best.change[0] - 0.05 * size) < 3.0 * best.std[0] < 0.01


def test_parameters_of_an_effect_change_together() -> None:
    size = np.array([0.3, -0.3, 0.0, 0.0, 0.0, 0.0])
    best = _find(2, 12, change=step(12, 5, size)).causes[0]
    assert (best.effect, best.parameters, best.onset) == ("com_offset", ("x", "y"), 5)
    assert (np.abs(np.array(best.change) - [0.015, -0.015]) < 3.0 * np.array(best.std)).all()


def test_interval_and_onset_of_a_drift() -> None:
    """Over 100 drifts, intervals cover the truth as often as stated, and half of the onsets err by two flights at most."""
    rng, inside, onsets = np.random.default_rng(3), [], []
    for _ in range(100):
        onset = int(rng.integers(4, 16))
        flights = make_flights(rng, MODEL, 20, change=drift(20, onset, 0.6 * THRUST))
        best = find_change(MODEL, flights, COLUMNS).causes[0]
        true_slope = 0.03 / (60.0 * (20 - onset))
        errors = (best.change[0] - 0.03, best.slope[0] - true_slope)
        inside.append(
            [abs(error) < 1.96 * std for error, std in zip(errors, (best.std[0], best.slope_std[0]), strict=True)]
        )
        onsets.append((abs(best.onset - onset), best.onset_low <= onset <= best.onset_high))
    assert (np.abs(np.mean(inside, axis=0) - 0.95) <= 3.0 * np.sqrt(0.95 * 0.05 / 100.0)).all()
    assert np.median([error for error, _ in onsets]) <= 2.0
    assert np.mean([covered for _, covered in onsets]) >= 0.9 - 3.0 * np.sqrt(0.9 * 0.1 / 100.0)


def test_collinear_causes_are_ambiguous() -> None:
    """Rotors 1 and 2 act through the same motion up to 0.1 %: both are candidates. With 30 % apart, one is."""
    for difference, candidates in ((0.001, {1, 2}), (0.3, {2})):
        mixing = np.eye(6)
        mixing[:, 3] = mixing[:, 2] + difference * mixing[:, 3]
        result = _find(4, 20, change=step(20, 8, 0.6 * THRUST), mixing=mixing)
        assert result.log_e > CLEAR
        assert {one.rotor for one in result.candidates if one.effect == "weak_motor"} == candidates


def test_effect_that_varies_from_flight_to_flight_has_not_changed() -> None:
    """Wind of 3 m/s in random directions in each flight, over 50 vehicles."""
    results = [_find(seed, 12) for seed in range(100, 150)]
    assert max(one.log_e for one in results) < np.log(20.0)


def test_vehicle_with_more_scatter_than_the_fleet_has_not_changed() -> None:
    """The thrust of rotor 2 scatters ten times as much as in the fleet, over 20 vehicles."""
    rng = np.random.default_rng(15)
    vehicles = [make_flights(rng, MODEL, 12, change=0.5 * rng.standard_normal((12, 1)) * THRUST) for _ in range(20)]
    assert max(find_change(MODEL, one, COLUMNS).log_e for one in vehicles) < np.log(20.0)


def test_intervals_of_a_vehicle_with_more_scatter_than_the_fleet() -> None:
    """Over 60 vehicles with five times the fleet's scatter, intervals of size and onset hold the truth as stated."""
    rng, model, columns = (
        np.random.default_rng(17),
        make_model(2, flight=0.1),
        make_columns(("weak_motor", "scale", 1), ""),
    )
    inside = []
    for _ in range(60):
        scatter = 0.5 * rng.standard_normal((30, 2))
        flights = make_flights(rng, model, 30, change=step(30, 15, [1.0, 0.0]), scatter=scatter)
        best = find_change(model, flights, columns).causes[0]
        inside.append([abs(best.change[0] - 0.05) < 1.96 * best.std[0], best.onset_low <= 15 <= best.onset_high])
    size, onset = np.mean(inside, axis=0)
    assert size >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 60.0)
    assert onset >= 0.9 - 3.0 * np.sqrt(0.9 * 0.1 / 60.0)


def test_steady_deviation_is_no_change() -> None:
    """A vehicle deviates by ten fleet standard deviations, which the first five of 12 flights cannot show."""
    rng = np.random.default_rng(5)
    flights = make_flights(rng, MODEL, 12, deviation=np.zeros(6), change=step(12, 5, 3.0 * THRUST))
    visible = np.ones((12, 6))
    visible[:5, 3] = 0.0
    hidden = replace(
        flights,
        product=flights.product * visible[:, :, None] * visible[:, None, :],
        gradient=flights.gradient * visible,
    )
    assert find_change(MODEL, hidden, COLUMNS).log_e < np.log(20.0)


@pytest.mark.parametrize("number", [0, 6, 11])
def test_one_odd_flight_is_no_change(number: int) -> None:
    result = _find(6, 12, change=step(12, number, 3.0 * THRUST) - step(12, number + 1, 3.0 * THRUST))
    assert result.log_e < np.log(20.0)
    assert result.odd_flights == (number,)


def test_change_beside_an_odd_flight_is_found() -> None:
    change = step(20, 9, 0.5 * THRUST) + 1.0 * (np.arange(20) == 3)[:, None] * THRUST
    result = _find(7, 20, change=change)
    assert result.log_e > CLEAR
    assert result.causes[0].onset == 9
    assert result.odd_flights == (3,)


def test_all_odd_flights_are_named() -> None:
    """Two of 30 flights deviate, in different effects: both are named, and the step keeps its flight."""
    odd = 4.0 * (np.arange(30) == 5)[:, None] * THRUST + 4.0 * (np.arange(30) == 12)[:, None] * np.eye(6)[1]
    result = _find(18, 30, change=odd + step(30, 20, 0.6 * THRUST))
    assert result.odd_flights == (5, 12)
    assert (result.causes[0].effect, result.causes[0].onset) == ("weak_motor", 20)
    assert result.log_e > CLEAR


def test_at_most_a_tenth_of_the_flights_are_odd() -> None:
    odd = 4.0 * np.isin(np.arange(20), (3, 8, 12, 17))[:, None] * THRUST
    assert len(_find(19, 20, change=odd).odd_flights) <= 2


@pytest.mark.parametrize(("start", "end"), [(8, 25), (5, 27), (10, 20), (22, 27), (12, 28)])
def test_repaired_vehicle_is_named(start: int, end: int) -> None:
    """Rotor 2 loses thrust in some of 30 flights, and is as before after them."""
    result = _find(21, 30, change=step(30, start, -0.6 * THRUST) - step(30, end, -0.6 * THRUST))
    best = result.causes[0]
    assert result.log_e > CLEAR
    assert (best.effect, best.rotor, result.end, result.second) == ("weak_motor", 2, end, None)
    assert best.onset_low <= start <= best.onset_high
    assert abs(best.change[0] + 0.03) < 3.0 * best.std[0] < 0.01


def test_lasting_change_has_no_end() -> None:
    for seed, onset in enumerate((4, 10, 15, 24), start=30):
        for pattern in (step, drift):
            result = _find(seed, 30, change=pattern(30, onset, 0.6 * THRUST))
            assert (result.end, result.second, result.odd_flights) == (None, None, ())


@pytest.mark.parametrize(("first", "second"), [(10, 20), (20, 10), (8, 24)])
def test_second_change_is_named(first: int, second: int) -> None:
    change = step(30, first, THRUST) + step(30, second, 0.5 * np.eye(6)[2])
    result = _find(22, 30, change=change)
    assert (result.causes[0].rotor, result.causes[0].onset, result.end) == (2, first, None)
    assert result.second is not None
    assert (result.second.causes[0].effect, result.second.causes[0].rotor) == ("weak_motor", 1)
    assert result.second.causes[0].onset_low <= second <= result.second.causes[0].onset_high


def test_change_of_firmware_within_the_onset_is_named() -> None:
    flights = make_flights(np.random.default_rng(8), MODEL, 12, change=step(12, 6, 0.6 * THRUST))
    for place, expected in ((6, ("1.0", "1.1")), (3, None)):
        updated = replace(flights, firmware=("1.0",) * place + ("1.1",) * (12 - place))
        assert find_change(MODEL, updated, COLUMNS).firmware_change == expected
    unknown = replace(flights, firmware=("1.0",) * 5 + ("",) + ("1.1",) * 6)
    assert find_change(MODEL, unknown, COLUMNS).firmware_change is None


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_flights_show_no_change(count: int) -> None:
    result = _find(9, count, change=step(count, 1, 3.0 * THRUST))
    assert np.isfinite(result.log_e)
    assert result.log_e < np.log(20.0)
    assert (result.causes == ()) == (count < 2)


def test_flights_without_information() -> None:
    flights = make_flights(np.random.default_rng(10), MODEL, 5, mixing=np.zeros((6, 6)))
    assert find_change(MODEL, flights, COLUMNS) == ChangeResult(vehicle="v", flights=5)


def test_equal_and_missing_times() -> None:
    """Flight numbers take the place of the times; equal times within others leave no drift undefined."""
    flights = make_flights(np.random.default_rng(11), MODEL, 12, change=step(12, 6, 0.6 * THRUST))
    some = np.repeat(np.arange(6.0), 2)
    for time in (np.zeros(12), np.full(12, np.nan), some, np.where(np.arange(12) < 10, np.arange(12), 9.0)):
        result = find_change(MODEL, replace(flights, time=time), COLUMNS)
        assert result.log_e > CLEAR
        assert result.causes[0].onset == 6
        assert all(np.isfinite((*one.change, *one.std, *one.slope_std)).all() for one in result.causes)


def test_change_within_a_gap_in_time_has_no_kind() -> None:
    """Of 20 flights, ten are flown a year later: a step and a drift since then look alike, so no limit is forecast."""
    flights = make_flights(np.random.default_rng(20), MODEL, 20, change=step(20, 10, -0.6 * THRUST))
    best = find_change(MODEL, replace(flights, time=flights.time + 3e7 * (np.arange(20) >= 10)), COLUMNS).causes[0]
    assert (best.effect, best.kind) == ("weak_motor", "")
    assert best.onset_low <= 10 <= best.onset_high
    assert time_to_limit(best, 0.9) is None


def test_order_of_columns_changes_nothing() -> None:
    flights, order = (
        make_flights(np.random.default_rng(12), MODEL, 12, change=step(12, 6, 0.6 * THRUST)),
        [3, 5, 0, 2, 4, 1],
    )
    turned = replace(flights, product=flights.product[:, order][:, :, order], gradient=flights.gradient[:, order])
    model = replace(MODEL, **{name: getattr(MODEL, name)[order] for name in ("mean", "var_vehicle", "var_flight")})
    first, second = find_change(MODEL, flights, COLUMNS), find_change(model, turned, [COLUMNS[k] for k in order])
    np.testing.assert_allclose(second.log_e, first.log_e, rtol=1e-9)
    assert [(one.effect, one.rotor, one.onset) for one in second.causes] == [
        (one.effect, one.rotor, one.onset) for one in first.causes
    ]


def test_vehicle_with_many_flights() -> None:
    """Of 800 flights, the onset is found to within its interval, although only 64 onsets are compared at a time."""
    best = _find(13, 800, change=step(800, 523, 0.2 * THRUST), rows=8).causes[0]
    assert (best.effect, best.rotor, best.kind) == ("weak_motor", 2, "step")
    assert best.onset_low <= 523 <= best.onset_high
    assert best.onset_high - best.onset_low < 20


def test_step_between_the_first_onsets_is_no_drift() -> None:
    """Steps late in 1300 flights, of which only every twentieth is compared first: each is a step since its flight."""
    rng = np.random.default_rng(16)
    model, columns = make_model(2, flight=0.05), make_columns(("weak_motor", "scale", 1), tolerances=1)
    for onset in range(1265, 1285, 4):
        flights = make_flights(rng, model, 1300, rows=8, change=step(1300, onset, [0.6, 0.0]))
        best = find_change(model, flights, columns).causes[0]
        assert best.kind == "step"
        assert abs(best.onset - onset) <= 2


@pytest.mark.parametrize("vehicles", [300, pytest.param(5000, marks=pytest.mark.slow)])
def test_no_false_discoveries_in_a_large_fleet(vehicles: int) -> None:
    """Among unchanged vehicles nothing is rejected at 1 %, and the mean e-value is at most 1."""
    model = make_model(3, flight=0.1)
    columns = make_columns("weak_motor", "torque_ratio", tolerances=1)
    fleet = make_fleet(np.random.default_rng(14), model, vehicles, 5, rows=6)
    log_e = np.array([find_change(model, one, columns).log_e for one in fleet])
    assert np.exp(log_e).mean() < 1.0
    assert not benjamini_hochberg(log_e, 0.01).any()


def _find(seed: int, count: int, **options: Any) -> ChangeResult:
    flights: VehicleFlights = make_flights(np.random.default_rng(seed), MODEL, count, **options)
    return find_change(MODEL, flights, COLUMNS)
