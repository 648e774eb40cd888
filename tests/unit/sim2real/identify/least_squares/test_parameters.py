"""Parameters of several effects in one row, and back."""

import numpy as np

from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.identify.least_squares.parameters import (
    is_number,
    parameter_bounds,
    parameter_row,
    parameter_scales,
    replace_params,
)
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
    assert [is_number("weak_motor", place) for place in (0, 1)] == [False, True]


def test_others_are_held_within_their_bounds_and_leave_the_rest_alone() -> None:
    _, high = parameter_bounds(ROBOT, EFFECTS)
    moved = replace_params(ROBOT, POINT, EFFECTS, np.array([2.0, high[1] + 1.0, -5.0, 0.4, 0.5]))
    np.testing.assert_array_equal(moved.effects["weak_motor"], [2.0, high[1]])
    np.testing.assert_array_equal(moved.effects["rotor_drag"], [0.0, 0.4, 0.5])  # a drag does not push
    np.testing.assert_array_equal(moved.effects["com_offset"], POINT.effects["com_offset"])
    np.testing.assert_array_equal(POINT.effects["rotor_drag"], [0.1, 0.2, 0.3])
