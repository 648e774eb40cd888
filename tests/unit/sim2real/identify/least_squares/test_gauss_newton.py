"""The statistics of the fit on data made from the model itself, where the truth is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from aerial_gym.sim2real.identify.least_squares.covariance import Uncertainty, uncertainty
from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    ModelFit,
    StopRule,
    fit_effects,
    least_cost_over_nuisances,
    least_squares_step_in_bounds,
    left_out_mean_square,
)
from aerial_gym.sim2real.identify.least_squares.moments import (
    block_length,
    block_moments,
    inverse_variance_weights,
    share_of_independent_rows,
)
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.statistics import rms_with_interval
from tests.unit.sim2real.flat_flights import PredictorStub

RATE, ROWS, FLIGHTS, CHANNELS = 30.0, 480, 5, 2
WIND, TRUTH = "constant_wind", np.array([0.5, -0.3, 0.2])
EFFECT, NUM_PARAMS, NUM_TOLERANCES = "rotor_drag", 3, 2


def linear_fit(
    rng: np.random.Generator, truth: np.ndarray, *, colour: float, deviation: np.ndarray, low: float = -np.inf
) -> ModelFit:
    """Return the linearisation at zero of ``r = J (truth, deviation) + coloured noise``, with random slow J."""
    times, residuals, jacobians = [], [], []
    for _ in range(FLIGHTS):
        shape = (ROWS, CHANNELS * (NUM_PARAMS + NUM_TOLERANCES))
        j = lowpass(rng.standard_normal(shape), RATE, 1.0).reshape(ROWS, CHANNELS, -1)
        noise = lowpass(rng.standard_normal((ROWS, CHANNELS)), RATE, colour)
        residuals.append(j @ np.concatenate((truth, deviation)) + noise)
        jacobians.append(j)
        times.append(np.arange(ROWS) / RATE)
    size = NUM_PARAMS + NUM_TOLERANCES
    return ModelFit(
        effects=(EFFECT,), params=ModelParams(effects={EFFECT: np.zeros(NUM_PARAMS)}),
        moments=block_moments(times, residuals, jacobians),
        low=np.concatenate((np.full(NUM_PARAMS, low), np.full(NUM_TOLERANCES, -3.0))), high=np.full(size, np.inf),
        num_effect_params=NUM_PARAMS,
    )  # fmt: skip


def test_each_flight_is_predicted_by_a_fit_of_the_others() -> None:
    """The mean of three logs with one row each, 1, 2 and 6: errors of 1 - 4, 2 - 3.5 and 6 - 1.5, mean square 10.5. With
    the first two of one flight: 1 - 6, 2 - 6 and 6 - 1.5, mean square 20.4."""
    times, residuals = [np.zeros(1)] * 3, [np.full((1, 1), value) for value in (1.0, 2.0, 6.0)]
    moments = block_moments(times, residuals, [np.ones((1, 1, 1))] * 3)
    limit, effects = np.full(1, np.inf), ("thrust_coefficient",)
    fit = ModelFit(
        effects=effects, params=ModelParams(effects={}), moments=moments, low=-limit, high=limit, num_effect_params=1
    )
    assert left_out_mean_square(fit, np.ones(1), np.arange(3)) == pytest.approx([10.5], rel=1e-3)
    assert left_out_mean_square(fit, np.ones(1), np.array([0, 0, 1])) == pytest.approx([61.25 / 3], rel=1e-3)


@pytest.mark.parametrize("colour", [pytest.param(15.0, marks=pytest.mark.slow), 2.0])
def test_intervals_cover_the_truth_in_coloured_noise_and_with_a_vehicle_that_is_off(colour: float) -> None:
    """95 % intervals hold 95 % of the time: white noise or slow noise, deviations of one sigma drawn anew. 240 trials
    of 3 parameters: at 95 % the count of misses is 36 +- 8 if parameters of a trial are correlated at most 0.3."""
    rng = np.random.default_rng(5)
    truth, inside, widths = np.array([0.5, -0.2, 0.3]), [], []
    for _ in range(240):
        fit = linear_fit(rng, truth, colour=colour, deviation=0.3 * rng.standard_normal(NUM_TOLERANCES))
        factor = np.repeat((1.0, 0.3), (NUM_PARAMS, NUM_TOLERANCES))  # a deviation of one is one sigma
        sums = fit.moments
        scaled = replace(sums, gradient=sums.gradient * factor, product=sums.product * factor * factor[:, None])
        spread = uncertainty(replace(fit, moments=scaled), np.ones(CHANNELS))
        inside.append(np.abs(spread.step[:NUM_PARAMS] - truth) < spread.half_width)
        widths.append(spread.half_width)
    coverage = float(np.mean(inside))
    assert 0.92 < coverage < 0.98, coverage
    assert np.median(widths) < 0.5  # no better by being useless


def spread_at_bound(bound: float, truth: float = 0.5) -> tuple[Uncertainty, ModelFit]:
    """Return the uncertainty with the first parameter at most ``bound``, in columns that the second one nearly shares."""
    fit = linear_fit(np.random.default_rng(3), np.array([truth, -0.2, 0.3]), colour=15.0, deviation=np.zeros(2))
    mix = np.eye(NUM_PARAMS + NUM_TOLERANCES)
    mix[0, 1] = 3.0  # the second column holds three times the first
    sums = fit.moments
    mixed = replace(sums, gradient=sums.gradient @ mix, product=mix.T @ sums.product @ mix)
    high = np.append(bound, fit.high[1:])
    fit = replace(fit, moments=mixed, high=high)
    return uncertainty(fit, np.ones(CHANNELS)), fit


def test_a_parameter_far_beyond_its_bound_widens_no_interval() -> None:
    """Where the flights ask for much more than the bound allows, the others have the interval of a parameter fixed there."""
    free, fit = spread_at_bound(np.inf)
    place = free.step[0] - 20.0 * free.std[0]
    held, at_bound = spread_at_bound(place)
    assert held.step[0] == place
    gradient = at_bound.moments.gradient - place * at_bound.moments.product[..., 0]
    there = replace(at_bound.moments, gradient=gradient)
    fixed = uncertainty(replace(fit, moments=there, frozen=frozenset({(EFFECT, 0)})), np.ones(CHANNELS))
    np.testing.assert_allclose(held.step[1:], fixed.step[1:], atol=1e-9)
    np.testing.assert_allclose(held.half_width[1:], fixed.half_width, rtol=0.05)
    assert held.half_width[1] < 0.5 * free.half_width[1]


@pytest.mark.parametrize("beyond", [0.0, 1.0, 3.0])
def test_the_interval_at_a_bound_is_that_of_the_truncated_normal(beyond: float) -> None:
    """95 % of a normal variable that lies below the bound is above the interval's end; its mode is ``beyond`` the bound."""
    free, _ = spread_at_bound(np.inf)
    held, _ = spread_at_bound(free.step[0] - (beyond + 1e-9) * free.std[0])
    below = 0.05 * stats.norm.cdf(-beyond)
    assert held.half_width[0] / free.std[0] == pytest.approx(-beyond - stats.norm.ppf(below), rel=0.01)


def test_the_best_step_solves_least_squares_and_respects_bounds() -> None:
    rng = np.random.default_rng(7)
    truth = np.array([0.5, -0.2, 0.3])
    fit = linear_fit(rng, truth, colour=15.0, deviation=np.zeros(NUM_TOLERANCES))
    full, sums = np.append(truth, np.zeros(NUM_TOLERANCES)), fit.moments
    noise_free = replace(sums, square=np.einsum("bckl,k,l->bc", sums.product, full, full), gradient=sums.product @ full)
    exact = replace(fit, moments=noise_free)
    np.testing.assert_allclose(
        least_squares_step_in_bounds(exact, np.ones(CHANNELS), exact.indices_of_fitted_effect_params)[:3],
        truth,
        atol=1e-5,
    )
    bounded = replace(exact, low=np.array([0.0, 0.0, 0.0, -3.0, -3.0]))
    result = least_squares_step_in_bounds(bounded, np.ones(CHANNELS), bounded.indices_of_fitted_effect_params)
    fixed = replace(exact, frozen=frozenset({(EFFECT, 1)}))
    np.testing.assert_allclose(
        result, least_squares_step_in_bounds(fixed, np.ones(CHANNELS), fixed.indices_of_fitted_effect_params), atol=1e-9
    )


def test_squares_after_a_step_are_those_of_the_rows() -> None:
    rng = np.random.default_rng(8)
    r, j, step = rng.standard_normal((60, 2)), rng.standard_normal((60, 2, 3)), np.array([0.3, -1.0, 2.0])
    moments = block_moments([np.arange(60) / 30.0], [r], [j])
    result = moments.block_squares(np.tile(step, (moments.count.size, 1))).sum(axis=0)
    np.testing.assert_allclose(result, ((r - j @ step) ** 2).sum(axis=0), rtol=1e-12)


def test_sums_of_blocks_are_joined_by_label_and_whole_flights_are_one_block() -> None:
    rng = np.random.default_rng(10)
    residuals = [rng.standard_normal((240, 2)) for _ in range(3)]
    jacobians = [rng.standard_normal((240, 2, 3)) for _ in range(3)]
    times = [np.arange(240) / 30.0] * 3
    blocks, flights = (block_moments(times, residuals, jacobians, length=length) for length in (2.0, np.inf))
    joined = blocks.sum_by_label(blocks.flight)
    assert blocks.count.tolist() == [60.0] * 12
    for some in (joined, flights):
        assert some.count.tolist() == [240.0] * 3
        assert some.flight.tolist() == [0, 1, 2]
    for name in ("square", "gradient", "product"):
        np.testing.assert_allclose(getattr(joined, name), getattr(flights, name), rtol=1e-12)
    np.testing.assert_allclose(flights.gradient[1], np.einsum("tck,tc->ck", jacobians[1], residuals[1]), rtol=1e-12)
    swapped = blocks.sum_by_label(2 - blocks.flight)
    np.testing.assert_allclose(swapped.product, joined.product[::-1], rtol=1e-12)
    assert swapped.flight.tolist() == [2, 1, 0]


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_the_effective_share_of_an_autoregression(memory: float) -> None:
    """x' = a x + e has (1 - a) / (1 + a) independent samples per row (Geyer 1992, section 2)."""
    rng = np.random.default_rng(9)
    noise, x = rng.standard_normal((20000, 1)), np.zeros((20000, 1))
    for row in range(1, len(x)):
        x[row] = memory * x[row - 1] + noise[row]
    assert share_of_independent_rows(x)[0] == pytest.approx((1.0 - memory) / (1.0 + memory), rel=0.15)
    assert inverse_variance_weights([x]).variance[0] == pytest.approx(1.0 / (1.0 - memory**2), rel=0.1)


def test_intervals_of_a_root_mean_square_cover_it() -> None:
    """Groups of 20 equal neighbours: the interval must be that of the groups, not of 20 times as many samples."""
    rng = np.random.default_rng(10)
    inside = []
    for seed in range(200):
        values = np.repeat(rng.standard_normal(60), 20)[:, None]
        (result,) = rms_with_interval(values, np.repeat(np.arange(60), 20), seed=seed)
        inside.append(result.low < 1.0 < result.high)
    assert 0.88 < np.mean(inside) < 0.99


def test_a_fit_that_would_overshoot_arrives() -> None:
    """Steps of Gauss-Newton on ``arctan x`` grow without end from far away; halved ones reach the truth."""
    rng = np.random.default_rng(2)
    excitation, truth = 1.0 + 0.1 * rng.standard_normal((40, 1)), 3.0
    measured = np.arctan(excitation * truth) + 1e-3 * rng.standard_normal((40, 1))
    predictor = PredictorStub(lambda params: [np.arctan(excitation * params.effects[WIND][0])], [measured])
    for start in (truth, 10.0, -6.0):
        params = ModelParams(effects={WIND: np.array([start, 0.0, 0.0])})
        fit, _, _ = fit_effects(predictor, (WIND,), params, nuisance_sums(predictor, 1e6))
        assert fit.params.effects[WIND][0] == pytest.approx(truth, rel=0.01)


def nuisance_sums(predictor: PredictorStub, weight: float) -> NuisanceSums:
    """Return sums of rows without nuisance columns, each of which has a weight."""
    return NuisanceSums(predictor.times, [[np.zeros((len(predictor.times[0]), 1, 0))]], np.full(1, weight))


def exponential(seed: int, remainder: float) -> tuple[PredictorStub, np.ndarray]:
    """Return a predictor of ``exp`` of parameters, measured at ``TRUTH`` with noise, and its (200, 3) derivative at zero."""
    rng = np.random.default_rng(seed)
    excitation = rng.standard_normal((200, 3))

    def predict(params: ModelParams) -> list[np.ndarray]:
        return [np.exp(0.5 * excitation @ params.effects[WIND])[:, None]]

    measured = predict(ModelParams(effects={WIND: TRUTH}))[0] + remainder * rng.standard_normal((200, 1))
    return PredictorStub(predict, [measured]), 0.5 * excitation


def test_a_fit_with_derivatives_at_hand_arrives_where_others_do() -> None:
    predictor, derivative = exponential(3, 1e-4)
    start = ModelParams(effects={WIND: np.zeros(3)})
    result, costs = [], []
    for wrong in (None, (1.0, 1.0, 1.0), (1.3, 0.4, 1.0)):
        predictor.calls = 0
        near = None if wrong is None else [(derivative * wrong)[:, None, :]]
        fit, _, _ = fit_effects(predictor, (WIND,), start, nuisance_sums(predictor, 1e8), derivatives=near)
        result.append(fit.params.effects[WIND])
        costs.append(predictor.calls)
    np.testing.assert_allclose(result, [TRUTH] * 3, atol=1e-4)
    assert costs[1] < costs[0]


def worth(fit: ModelFit) -> float:
    """Return the log likelihood of the linear model about a fit where it is best."""
    step = least_squares_step_in_bounds(fit, np.ones(1), fit.indices_of_fitted_params)
    gradient, product = fit.moments.gradient.sum(axis=(0, 1)), fit.moments.product.sum(axis=(0, 1))
    return float(gradient @ step - 0.5 * step @ product @ step) - 0.5 * float(fit.moments.square.sum())


def fit_exponential(rule: StopRule) -> tuple[ModelFit, float, float, int]:
    """Return a fit from zero, its log likelihood, what it may have missed at most, and its predictions."""
    predictor, _ = exponential(4, 0.3)
    sums = nuisance_sums(predictor, 1e3)
    fit, _, more = fit_effects(predictor, (WIND,), ModelParams(effects={WIND: np.zeros(3)}), sums, rule=rule)
    count = predictor.calls
    return fit, -0.5 * least_cost_over_nuisances(sums, predictor.residuals(fit.params)), more, count


def test_a_fit_that_cannot_reach_its_goal_ends_at_once_and_any_other_arrives() -> None:
    _, reached, _, whole = fit_exponential(StopRule())
    fit, nowhere, more, few = fit_exponential(StopRule(worth=worth, least=reached + 1e5))
    assert worth(fit) + more > reached > nowhere
    assert few < whole / 2
    assert fit_exponential(StopRule(worth=worth, least=reached - 1.0))[1] == pytest.approx(reached, abs=1e-6)


def test_a_fit_ends_where_its_own_derivatives_promise_no_more_than_is_enough() -> None:
    _, reached, _, whole = fit_exponential(StopRule())
    fit, _, _, few = fit_exponential(StopRule(enough=5.0))
    assert few < whole
    assert worth(fit) == pytest.approx(reached, abs=0.5)


@pytest.mark.parametrize("derivatives", [None, [np.full((40, 1, 3), np.nan)]])
def test_a_fit_whose_derivatives_are_not_finite_goes_nowhere(derivatives: list[np.ndarray] | None) -> None:
    edge = ModelParams(effects={WIND: np.array([1.0, 0.0, 0.0])})

    def predict(params: ModelParams) -> list[np.ndarray]:
        return [np.full((40, 1), 1.0 if np.array_equal(params.effects[WIND], edge.effects[WIND]) else np.nan)]

    predictor = PredictorStub(predict, [np.full((40, 1), 2.0)])
    fit, _, _ = fit_effects(predictor, (WIND,), edge, nuisance_sums(predictor, 1.0), derivatives=derivatives)
    assert fit.params is edge
    assert not fit.is_finite


def test_short_flights_have_short_blocks() -> None:
    assert [block_length([np.array([0.0, span])] * 3) for span in (2.0, 5.0, 16.0, 100.0)] == [0.5, 0.625, 2.0, 2.0]
    times = [np.arange(150) / 50.0] * 4
    moments = block_moments(times, [np.ones((150, 1))] * 4, [np.ones((150, 1, 1))] * 4)
    np.testing.assert_array_equal(moments.flight, np.repeat(np.arange(4), 6))
    assert moments.count.tolist() == [25.0] * 24
