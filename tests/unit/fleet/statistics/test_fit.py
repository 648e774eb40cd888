"""The fleet's distribution, and a vehicle's parameters under it."""

from dataclasses import replace

import numpy as np

from aerial_gym.fleet.statistics import VehicleFlights, draw_vehicles, find_change, fit_fleet, vehicle_posterior
from tests.unit.fleet.statistics.synthetic import make_columns, make_fleet, make_flights, make_model, step

COLUMNS = make_columns("weak_motor", "torque_ratio", "rotor_drag", tolerances=1)
TRUTH = {"mean": np.array([0.5, -0.3, 0.0, 0.2]), "vehicle": np.array([0.3, 0.1, 0.5, 0.2]), "flight": 0.05}


def test_textbook_shrinkage() -> None:
    """One column, N flights of information a: the weight of the flights' mean is ``V / (V + (F + 1 / a) / N)``."""
    model = make_model(1, mean=0.2, vehicle=0.4, flight=0.1)
    values, information = np.array([0.7, 0.9, 0.8]), 25.0
    flights = VehicleFlights(
        vehicle="v", product=np.full((3, 1, 1), information), gradient=information * values[:, None],
        time=np.arange(3.0), firmware=("",) * 3,
    )  # fmt: skip
    result = vehicle_posterior(model, flights, make_columns("weak_motor"))
    noise = (0.01 + 1.0 / information) / 3.0
    weight = 0.16 / (0.16 + noise)
    np.testing.assert_allclose(result.mean, 1.0 + 0.05 * (0.2 + weight * 0.6), rtol=1e-6)
    np.testing.assert_allclose(result.std, 0.05 * np.sqrt(weight * noise), rtol=1e-5)


def test_distribution_of_a_fleet() -> None:
    """Mean and variances agree with the truth within three standard errors of 60 vehicles with 10 flights.

    A flight of 40 rows shows its deviation with a variance of 1/360, which adds to that between flights.
    """
    model = make_model(4, **TRUTH)
    fitted = fit_fleet(make_fleet(np.random.default_rng(0), model, 60, 10), COLUMNS)
    assert (np.abs(fitted.mean - model.mean) < 3.0 * np.sqrt(fitted.mean_var)).all()
    np.testing.assert_allclose(fitted.mean_var, (model.var_vehicle + 0.05**2 / 10.0) / 60.0, rtol=0.5)
    assert (np.abs(np.log(fitted.var_vehicle / model.var_vehicle)) < 3.0 * np.sqrt(2.0 / 60.0)).all()
    error = np.sqrt(2.0 / 540.0) * (1.0 + 1.0 / 360.0 / model.var_flight)
    assert (np.abs(np.log(fitted.var_flight / model.var_flight)) < 3.0 * error).all()


def test_interval_of_a_vehicle_covers_the_truth() -> None:
    """68 % intervals of 200 vehicles hold 68 % of the true values, within three binomial standard errors."""
    rng, model = np.random.default_rng(1), make_model(4, **TRUTH)
    deviations = np.sqrt(model.var_vehicle) * rng.standard_normal((200, 4))
    fleet = [make_flights(rng, model, 2, rows=4, deviation=own) for own in deviations]
    inside = [
        np.abs(one.mean - (neutral + scale * (model.mean + own))) < one.std
        for own, flights in zip(deviations, fleet, strict=True)
        for one in [vehicle_posterior(model, flights, COLUMNS)]
        for scale, neutral in [(np.array([0.05, 0.05, 0.05, 1.0]), np.array([1.0, 1.0, 1.0, 0.0]))]
    ]
    assert np.abs(np.mean(inside) - 0.6827) < 3.0 * np.sqrt(0.6827 * 0.3173 / 800.0)


def test_state_of_a_changed_vehicle_is_that_of_its_last_flights() -> None:
    """The cause's level follows the change, and other parameters the flights since; a repaired vehicle is as before."""
    rng, model, size = np.random.default_rng(6), make_model(4, **TRUTH), np.array([1.0, 0.0, 0.0, 0.0])
    flights = make_flights(rng, model, 20, deviation=np.zeros(4), change=step(20, 10, size))
    result = find_change(model, flights, COLUMNS)
    state = vehicle_posterior(model, flights, COLUMNS, result)
    assert abs(state.mean[0] - (1.0 + 0.05 * 1.5)) < 3.0 * state.std[0] < 0.01
    repaired = replace(flights, gradient=flights.gradient - flights.product @ size * (np.arange(20) >= 15)[:, None])
    result = find_change(model, repaired, COLUMNS)
    assert result.end == 15
    state = vehicle_posterior(model, repaired, COLUMNS, result)
    assert abs(state.mean[0] - (1.0 + 0.05 * 0.5)) < 3.0 * state.std[0] < 0.01


def test_changed_vehicles_hide_nothing_in_the_variance() -> None:
    """One of ten vehicles changes by 60 standard deviations: the variance grows by less than half, not ninety-fold."""
    rng, model = np.random.default_rng(2), make_model(4, **TRUTH)
    fleet = make_fleet(rng, model, 10, 10)
    changed = make_flights(rng, model, 10, vehicle="v0", change=step(10, 5, [3.0, 0.0, 0.0, 0.0]))
    fitted, disturbed = (fit_fleet(vehicles, COLUMNS) for vehicles in (fleet, [changed, *fleet[1:]]))
    assert disturbed.var_flight[0] < 1.5 * fitted.var_flight[0]


def test_columns_without_information_keep_the_prior() -> None:
    rng, model = np.random.default_rng(3), make_model(4, **TRUTH)
    fleet = make_fleet(rng, model, 5, 4, mixing=np.diag([1.0, 0.0, 1.0, 1.0]))
    fitted = fit_fleet(fleet, COLUMNS)
    values = (fitted.mean[1], fitted.var_vehicle[1], fitted.var_flight[1], fitted.mean_var[1])
    np.testing.assert_allclose(values, (0.0, 1.0, 0.01, 1.0), rtol=1e-12)
    assert np.isfinite([fitted.mean, fitted.var_vehicle, fitted.var_flight, fitted.mean_var]).all()
    result = vehicle_posterior(fitted, fleet[0], COLUMNS)
    np.testing.assert_allclose((result.mean[1], result.std[1]), (1.0, 0.05), rtol=1e-12)


def test_least_fleets() -> None:
    """No vehicle, one vehicle and one flight give finite models."""
    rng, model = np.random.default_rng(4), make_model(4, **TRUTH)
    for fleet in ([], make_fleet(rng, model, 1, 1), make_fleet(rng, model, 1, 8)):
        fitted = fit_fleet(fleet, COLUMNS)
        assert np.isfinite([fitted.mean, fitted.var_vehicle, fitted.var_flight, fitted.mean_var]).all()
        assert (fitted.var_flight > 0.0).all()


def test_order_of_vehicles_and_of_columns_changes_nothing() -> None:
    rng, model = np.random.default_rng(5), make_model(4, **TRUTH)
    fleet, order = make_fleet(rng, model, 8, 5), np.array([2, 0, 3, 1])
    first, second = fit_fleet(fleet, COLUMNS), fit_fleet(fleet[::-1], COLUMNS)
    assert np.array_equal(first.mean, second.mean)
    assert np.array_equal(first.var_flight, second.var_flight)
    turned = [
        VehicleFlights(
            vehicle=one.vehicle, product=one.product[:, order][:, :, order], gradient=one.gradient[:, order],
            time=one.time, firmware=one.firmware,
        )
        for one in fleet
    ]  # fmt: skip
    third = fit_fleet(turned, [COLUMNS[k] for k in order])
    np.testing.assert_allclose(third.mean, first.mean[order], rtol=1e-9)
    np.testing.assert_allclose(third.var_flight, first.var_flight[order], rtol=1e-9)


def test_draw_of_vehicles_depends_on_names_alone() -> None:
    names = [f"vehicle {k}" for k in range(500)]
    drawn = draw_vehicles(names)
    assert len(drawn) == 64
    assert drawn == draw_vehicles(reversed(names))
    assert set(draw_vehicles(names[:300])) >= set(drawn) & set(names[:300])
