"""Derivatives of predictions in closed form, and sums of weighted products against dense least squares."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.identify.least_squares.derivative_sums import (
    NuisanceSums,
    SparseDerivatives,
    drop_zero_channels,
    moments_by_channel,
    num_columns,
    weighted_moments,
)
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    correct_derivatives,
    effect_jacobian,
    parameter_bounds,
    parameter_scales,
    rms_caused_by_tolerances,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import least_cost_over_nuisances
from aerial_gym.sim2real.identify.least_squares.moments import block_moments
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.tolerances import is_tolerance_of_logs
from tests.unit.sim2real.flat_flights import PredictorStub

ROBOT = ROBOTS.get("base_quadrotor")
ROWS = np.array([1.0, -2.0, 3.0])
NUM_TOLERANCES = is_tolerance_of_logs(4).size


def of_deviations(params: ModelParams) -> list[np.ndarray]:
    """Return two channels that follow the product of the first two deviations, and the third: (rows, 2)."""
    d = np.zeros(NUM_TOLERANCES) if params.deviation is None else params.deviation
    return [np.outer(ROWS, (d[0] * d[1] + d[0], d[2]))]


def test_derivatives_half_way_to_deviations_say_what_they_do_together() -> None:
    deviation = np.zeros(NUM_TOLERANCES)
    deviation[:3] = 0.8, -1.5, 2.0
    params = ModelParams(effects={}, deviation=deviation)
    (columns,) = tolerance_jacobian(PredictorStub(of_deviations, robot=ROBOT), params)
    together = of_deviations(params)[0]
    np.testing.assert_allclose(columns @ deviation, together, atol=1e-9)
    (nowhere,) = tolerance_jacobian(PredictorStub(of_deviations, robot=ROBOT), ModelParams(effects={}))
    np.testing.assert_allclose(nowhere @ deviation, np.outer(ROWS, (0.8, 2.0)), atol=1e-9)


def test_what_is_tolerated_is_what_the_vehicle_may_be_off_by_and_not_its_log() -> None:
    sizes = np.where(is_tolerance_of_logs(4), 100.0, 1.0)

    def predict(params: ModelParams) -> list[np.ndarray]:
        d = np.zeros(NUM_TOLERANCES) if params.deviation is None else params.deviation
        return [np.full((5, 1), float(sizes @ d))]

    tolerance = tolerance_jacobian(PredictorStub(predict, robot=ROBOT), ModelParams(effects={}))
    result = rms_caused_by_tolerances(tolerance, 4)
    assert result == pytest.approx(np.sqrt(np.count_nonzero(np.logical_not(is_tolerance_of_logs(4)))))


def test_derivatives_by_parameters_are_per_scale_within_bounds_and_of_numbers_alone() -> None:
    asked: list[float] = []

    def predict(params: ModelParams) -> list[np.ndarray]:
        _, scale = params.effects["weak_motor"]
        asked.append(scale)
        return [np.outer(ROWS, (scale**2, 1.0))]

    (_, top), scale = parameter_bounds(ROBOT, ("weak_motor",))[1], parameter_scales(("weak_motor",))[1]
    params = ModelParams(effects={"weak_motor": np.array([2.0, top])})  # the number of the motor, and its scale
    beside = [np.full((3, 2, 1), 7.0)]
    predictor = PredictorStub(predict, robot=ROBOT)
    (result,) = effect_jacobian(predictor, params, ("weak_motor",), predict(params), beside=beside)
    assert result.shape == (3, 2, 3)
    assert asked == [top, pytest.approx(top - 1e-3 * scale)]
    np.testing.assert_array_equal(result[:, :, 0], 0.0)
    np.testing.assert_allclose(result[:, 0, 1], ROWS * (2.0 * top - 1e-3 * scale) * scale)
    np.testing.assert_array_equal(result[:, 1, 1], 0.0)
    np.testing.assert_array_equal(result[:, :, 2], 7.0)


def test_derivatives_are_made_exact_along_a_step_and_kept_across_it() -> None:
    rng = np.random.default_rng(0)
    columns, change, step = rng.standard_normal((3, 2, 20)).T, rng.standard_normal((20, 2)), np.array([0.3, 0.0, -1.2])
    exact = columns.copy(order="K")
    correct_derivatives([exact], step, [change])
    np.testing.assert_allclose(exact @ step, change, atol=1e-12)
    for across in ([1.2, 0.0, 0.3], [0.0, 1.0, 0.0]):
        np.testing.assert_allclose(exact @ across, columns @ across, atol=1e-12)
    assert exact.T.flags.c_contiguous  # rows are neighbours, as they are written and read
    kept = columns.copy(order="K")
    correct_derivatives([kept], np.zeros(3), [change])
    np.testing.assert_array_equal(kept, columns)


RATE, WEIGHT = 30.0, np.array([0.5, 2.0, 7.0])


@dataclass
class Sums:
    """Two flights with residuals, a dense derivative, and ones of the first and of the last two channels alone."""

    times: list[np.ndarray]
    residuals: list[np.ndarray]
    dense: list[np.ndarray]
    first: list[SparseDerivatives]
    last: list[SparseDerivatives]


def flights(seed: int) -> Sums:
    rng, times = np.random.default_rng(seed), [np.arange(rows) / RATE for rows in (240, 150)]
    dense = [rng.standard_normal((time.size, 3, 4)) for time in times]
    for part in dense:
        part[:, 1, :2] = 0.0  # two columns that leave a channel alone

    def sparse(columns: int, **place: Any) -> list[SparseDerivatives]:
        return [SparseDerivatives(values=rng.standard_normal((time.size, columns, 2)), **place) for time in times]

    residuals = [rng.standard_normal((time.size, 3)) for time in times]
    first, last = sparse(1, channels=(0,), width=2), sparse(2, channels=(2, 1), width=3, first=1)
    return Sums(times=times, residuals=residuals, dense=dense, first=first, last=last)


def whole(part: SparseDerivatives) -> np.ndarray:
    result = np.zeros((part.values.shape[0], 3, part.width))
    result[:, list(part.channels), part.first : part.first + part.values.shape[2]] = part.values
    return result


def test_zeros_are_put_back_as_they_were() -> None:
    dense = [part.astype(np.float32) for part in flights(1).dense]
    for part in dense:
        part[:, 2] = 0.0
    dense[0][:, 0] = 0.0  # in one flight alone
    kept = drop_zero_channels(dense)
    for part, whole_part in zip(kept, dense, strict=True):
        assert part.channels == (0, 1)
        np.testing.assert_array_equal(part.dense_columns(range(3)), whole_part)
    late = flights(1).last[0]
    np.testing.assert_array_equal(late.dense_columns(range(3)), whole(late))


@pytest.mark.parametrize("parts", [1, 4])
def test_weighted_sums_are_those_of_the_channels_times_their_weights(parts: int) -> None:
    own = flights(3)
    columns = list(zip(own.dense, own.first, own.last, strict=True))
    assert num_columns(columns[0]) == 9
    jacobians = [np.concatenate((dense, whole(first), whole(last)), axis=2) for dense, first, last in columns]
    apart = [
        [part for whole in each for part in np.array_split(whole, parts)]
        for each in (own.times, own.residuals, jacobians)
    ]
    expected = block_moments(*apart, length=np.inf)
    all_beside = weighted_moments(own.times, own.residuals, columns, WEIGHT, parts=parts)
    behind = NuisanceSums(own.times, [part[1:] for part in columns], WEIGHT, parts=parts)
    for result in (all_beside, behind.moments_with_effects(own.residuals, own.dense)):
        for name in ("product", "gradient"):
            sums = np.einsum("c,bc...->b...", WEIGHT, getattr(expected, name))
            np.testing.assert_allclose(getattr(result, name)[:, 0], sums, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(result.square[:, 0], expected.square @ WEIGHT, rtol=1e-12)
        assert result.flight.tolist() == np.repeat([0, 1], parts).tolist()
        assert result.count.tolist() == expected.count.tolist()


def test_sums_by_channel_are_those_of_whole_flights() -> None:
    own = flights(5)
    for residual in own.residuals:
        residual[:, 2] = 0.0
    jacobians = [np.concatenate((a, whole(b)), axis=2) for a, b in zip(own.dense, own.last, strict=True)]
    expected = block_moments(own.times, own.residuals, jacobians, length=np.inf)
    result = moments_by_channel(own.residuals, list(zip(own.dense, own.last, strict=True)))
    for name in ("count", "square", "gradient", "product", "flight"):
        np.testing.assert_allclose(getattr(result, name), getattr(expected, name), rtol=1e-12, atol=1e-12)


def test_a_misfit_is_the_least_of_weighted_squares_and_prior() -> None:
    """Ridge regression, by least squares of a longer system (Hoerl, Kennard 1970)."""
    own = flights(4)
    beside = NuisanceSums(own.times, list(zip(own.dense, own.last, strict=True)), WEIGHT, parts=3)
    jacobians = [np.concatenate((a, whole(b)), axis=2) for a, b in zip(own.dense, own.last, strict=True)]
    root = np.sqrt(WEIGHT)
    rows = np.concatenate([(j * root[:, None]).reshape(-1, 7) for j in jacobians])
    values = np.concatenate([(r * root).reshape(-1) for r in own.residuals])
    system, right = np.vstack((rows, np.eye(7))), np.append(values, np.zeros(7))
    step = np.linalg.lstsq(system, right, rcond=None)[0]
    assert least_cost_over_nuisances(beside, own.residuals) == pytest.approx(
        float(((right - system @ step) ** 2).sum()), rel=1e-10
    )
    own.residuals[1][7, 1] = np.nan
    assert least_cost_over_nuisances(beside, own.residuals) == np.inf
