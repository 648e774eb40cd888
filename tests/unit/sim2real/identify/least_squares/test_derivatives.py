"""Derivatives of predictions whose closed form is known."""

import numpy as np
import pytest

from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    correct_derivatives,
    effect_jacobian,
    tolerance_jacobian,
    tolerance_rms,
)
from aerial_gym.sim2real.identify.least_squares.parameters import parameter_bounds, parameter_scales
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
    result = tolerance_rms(tolerance, 4)
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
