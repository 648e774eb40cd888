"""Parameters of several effects in one row, their minimum within bounds, and offsets of flights."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.identify.evidence.laplace import NormalEquations
from aerial_gym.sim2real.identify.least_squares import box_minimum
from aerial_gym.sim2real.identify.least_squares.box_minimum import minimise_in_bounds
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    is_continuous_parameter,
    parameter_bounds,
    parameter_row,
    parameter_scales,
    replace_params,
)
from aerial_gym.sim2real.identify.least_squares.moments import FlightOffsets
from aerial_gym.sim2real.predict.model_params import ModelParams

ROBOT = ROBOTS.get("base_quadrotor")
EFFECTS = ("weak_motor", "rotor_drag")
POINT = ModelParams(
    effects={"rotor_drag": np.array([0.1, 0.2, 0.3]), "com_offset": np.zeros(3), "weak_motor": np.array([3.0, 0.9])}
)


def test_parameters_stand_in_the_order_of_the_effects_that_are_requested() -> None:
    np.testing.assert_array_equal(parameter_row(POINT, EFFECTS), [3.0, 0.9, 0.1, 0.2, 0.3])
    assert parameter_row(POINT, ()).size == 0
    low, high = parameter_bounds(ROBOT, EFFECTS)
    assert parameter_scales(EFFECTS).shape == low.shape == high.shape == (5,)
    assert [is_continuous_parameter("weak_motor", place) for place in (0, 1)] == [False, True]


def test_others_are_held_within_their_bounds_and_leave_the_rest_alone() -> None:
    _, high = parameter_bounds(ROBOT, EFFECTS)
    moved = replace_params(ROBOT, POINT, EFFECTS, np.array([2.0, high[1] + 1.0, -5.0, 0.4, 0.5]))
    np.testing.assert_array_equal(moved.effects["weak_motor"], [2.0, high[1]])
    np.testing.assert_array_equal(moved.effects["rotor_drag"], [0.0, 0.4, 0.5])  # a drag does not push
    np.testing.assert_array_equal(moved.effects["com_offset"], POINT.effects["com_offset"])
    np.testing.assert_array_equal(POINT.effects["rotor_drag"], [0.1, 0.2, 0.3])


def problem(seed: int, size: int = 30) -> tuple[NDArray[np.float64], ...]:
    """Return sums of strongly correlated columns of different sizes, and bounds of which many are met; some are none, or 0."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(2 * size, size)) * 10.0 ** rng.uniform(-2.0, 2.0, size)
    columns += 0.9 * columns[:, :1]
    high = np.where(rng.random(size) < 0.2, np.inf, rng.uniform(0.0, 1.0, size))
    low = np.where(rng.random(size) < 0.2, 0.0, -high)
    return columns.T @ columns + np.eye(size), columns.T @ rng.normal(scale=3.0, size=2 * size), low, high


@pytest.mark.parametrize("rounds", [box_minimum.MOST_ROUNDS, 0])
def test_the_minimum_is_that_of_another_method(rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(box_minimum, "MOST_ROUNDS", rounds)
    for seed in range(20):
        a, b, low, high = problem(seed)
        root = np.linalg.cholesky(a).T
        bounds = np.minimum(low, -1e-12), np.maximum(high, 1e-12)
        expected = lsq_linear(root, np.linalg.solve(root.T, b), bounds=bounds, method="trf", tol=1e-14, max_iter=500).x
        np.testing.assert_allclose(minimise_in_bounds(a, b, low, high), expected, rtol=0.0, atol=2e-6)


def test_no_minimum_of_numbers_that_are_none() -> None:
    a, b, low, high = problem(0)
    assert np.isnan(minimise_in_bounds(a, np.where(np.arange(b.size) == 3, np.nan, b), low, high)).all()


def flights(rng: np.random.Generator) -> tuple[list[np.ndarray], list[np.ndarray]]:
    rows = (7, 12, 30)
    return [rng.standard_normal((n, 2)) for n in rows], [rng.standard_normal((n, 2, 3)) for n in rows]


def test_it_is_what_is_left_of_a_column_for_each_flight() -> None:
    residuals, jacobians = flights(np.random.default_rng(2))
    size, weight = 0.4, 3.0
    offsets = FlightOffsets(size=np.array([size, 0.0]), weight=np.array([weight, weight]), most=np.ones(2))
    product, gradient, constant = np.zeros((6, 6)), np.zeros(6), 0.0
    for place, (r, j) in enumerate(zip(residuals, jacobians, strict=True)):
        for channel in range(2):
            columns = np.column_stack((j[:, channel], np.zeros((len(r), 3))))
            columns[:, 3 + place] = size * (channel == 0)
            product += weight * columns.T @ columns
            gradient += weight * columns.T @ r[:, channel]
            constant -= 0.5 * weight * r[:, channel] @ r[:, channel]
    kept = NormalEquations(product=product, gradient=gradient, constant=constant).integrate_out(
        np.arange(3, 6), np.arange(3)
    )
    pairs = list(zip(offsets.remove_offsets(residuals), offsets.remove_offsets(jacobians), strict=True))
    product_kept = sum(weight * np.einsum("rck,rcl->kl", j, j) for _, j in pairs)
    gradient_kept = sum(weight * np.einsum("rck,rc->k", j, r) for r, j in pairs)
    np.testing.assert_allclose(kept.product, product_kept, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(kept.gradient, gradient_kept, rtol=1e-10, atol=1e-12)

    left = -0.5 * sum(weight * np.square(r).sum() for r, _ in pairs)
    np.testing.assert_allclose(kept.constant, left + offsets.log_likelihood([len(r) for r in residuals]), rtol=1e-12)


def test_without_offsets_nothing_changes() -> None:
    residuals, _ = flights(np.random.default_rng(3))
    offsets = FlightOffsets(size=np.zeros(2), weight=np.ones(2), most=np.ones(2))
    assert not offsets.has_offsets
    for before, after in zip(residuals, offsets.remove_offsets(residuals), strict=True):
        assert after is before
