"""Bayes factors of a change against the marginal likelihood of the measurements themselves."""

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from aerial_gym.fleet.statistics import VehicleFlights
from aerial_gym.fleet.statistics.change import ChangeSearch, change_patterns, onset_weights
from aerial_gym.fleet.statistics.scan import SIZES, ChangeScan, Hypotheses
from aerial_gym.sim2real.arrays import Indices
from tests.unit.fleet.statistics.synthetic import make_columns, make_flights, make_model

COLUMNS = make_columns(("motor_tilt", "roll", 1), ("motor_tilt", "pitch", 1), "torque_ratio", tolerances=1)


def test_bayes_factor_of_a_change() -> None:
    """Equal to the ratio of the normal densities of ``y_i = J_i (base + w_i + g_i d) + e``, with and without d."""
    rng, flights, rows = np.random.default_rng(0), 4, 3
    mean, var_flight, root = np.array([0.1, -0.2, 0.3]), np.array([0.04, 0.0, 0.09]), np.array([1.0, 0.5, 2.0])
    derivatives, measured = rng.standard_normal((flights, rows, 3)), 2.0 * rng.standard_normal((flights, rows))
    product = derivatives.swapaxes(1, 2) @ derivatives
    gradient = (derivatives.swapaxes(1, 2) @ measured[:, :, None])[:, :, 0]
    scan = ChangeScan.from_flights(product, gradient, mean, var_flight, root)
    places, pattern = np.array([0, 2]), np.array([0.0, 0.0, 0.5, 1.0])

    stacked = derivatives.reshape(-1, 3)
    own_flight = np.kron(np.eye(flights), np.ones((rows, rows)))
    noise = np.eye(flights * rows) + own_flight * (stacked * var_flight @ stacked.T)
    steady = noise + stacked * root**2 @ stacked.T
    changing = np.repeat(pattern, rows)[:, None] * stacked[:, places]
    densities = [
        multivariate_normal.logpdf(measured.ravel(), stacked @ mean, steady + size**2 * changing @ changing.T)
        for size in (0.0, *SIZES)
    ]
    expected = np.array(densities[1:]) - densities[0]
    hypotheses = _hypothesis(places)
    np.testing.assert_allclose(scan.log_factors(pattern[None], hypotheses)[0, 0], expected, rtol=1e-4)

    more, constant = scan.with_scatter(places, np.array([0.3, -0.05]))
    direct = ChangeScan.from_flights(product, gradient, mean, np.array([0.34, 0.0, 0.04]), root)
    np.testing.assert_allclose(more.product, direct.product, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(more.gradient, direct.gradient, rtol=1e-4, atol=1e-5)
    own = own_flight * (stacked * (np.array([0.34, 0.0, 0.04]) - var_flight) @ stacked.T)
    wider = multivariate_normal.logpdf(measured.ravel(), stacked @ mean, steady + own)
    np.testing.assert_allclose(constant + more.log_marginal - scan.log_marginal, wider - densities[0], atol=1e-4)


def test_textbook_change_point() -> None:
    """One column with a free base: the difference of two means of k and N - k flights has variance ``v (1/k + 1/(N-k))``."""
    rng, count, onset = np.random.default_rng(1), 10, 4
    values, variance = rng.standard_normal(count), 0.04 + 1.0 / 25.0
    scan = ChangeScan.from_flights(
        np.full((count, 1, 1), 25.0), 25.0 * values[:, None], np.zeros(1), np.full(1, 0.04), np.full(1, 1e3)
    )
    only = _hypothesis(np.zeros(1, dtype=int))
    pattern = change_patterns("step", np.array([onset]), np.arange(count))
    difference, own = values[onset:].mean() - values[:onset].mean(), variance * (1.0 / onset + 1.0 / (count - onset))
    factors = [multivariate_normal.pdf(difference, 0.0, own + size**2) for size in SIZES]
    expected = np.log(factors) - np.log(multivariate_normal.pdf(difference, 0.0, own))
    np.testing.assert_allclose(scan.log_factors(pattern, only)[0, 0], expected, rtol=1e-4, atol=1e-5)


def test_mean_of_the_evidence_is_one_without_a_change() -> None:
    """Over 600 vehicles whose base follows the prior, at noise that leaves changes of 0.3 to 3 units uncertain."""
    rng, model = np.random.default_rng(2), make_model(4, vehicle=1.0, flight=0.8)
    values = [
        np.exp(logsumexp(_search(make_flights(rng, model, 4, rows=6), model).log_evidence())) for _ in range(3000)
    ]
    mean, error = np.mean(values), np.std(values) / np.sqrt(600.0)
    assert abs(mean - 1.0) < 3.0 * error
    assert error < 0.3


def test_priors_sum_to_one() -> None:
    columns = [*COLUMNS, *COLUMNS[:2]]
    for column in columns[-2:]:
        column.start = 1
    hypotheses = Hypotheses.from_columns(columns, np.ones(6, dtype=bool))
    assert np.exp(hypotheses.log_prior).sum() == 1.0
    for onsets in (np.arange(1, 20), np.array([1, 5, 40, 100])):
        np.testing.assert_allclose(onset_weights(onsets).sum(), 1.0, rtol=1e-12)


def _search(flights: VehicleFlights, model: object) -> ChangeSearch:
    scan = ChangeScan.from_flights(flights.product, flights.gradient, np.zeros(4), np.full(4, 0.64), np.ones(4))
    return ChangeSearch(
        scan=scan,
        hypotheses=Hypotheses.from_columns(COLUMNS, np.ones(4, dtype=bool)),
        time=flights.time,
        onsets=np.arange(1, len(flights.firmware)),
    )


def _hypothesis(places: Indices) -> Hypotheses:
    return Hypotheses(causes=(("a", 0),), cause=np.zeros(1, dtype=int), columns=(places,), log_prior=np.zeros(1))
