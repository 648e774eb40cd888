"""What flights can test: where parameters end."""

import numpy as np

from aerial_gym.sim2real.identify.candidates.testable import at_bounds
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import ROBOT


def test_a_parameter_that_ends_where_physics_does_is_told() -> None:
    """A drag of 0 along y is where the effect begins, a bound of an inertia is not."""
    neutral = np.ones(3)
    params = ModelParams(effects={"inertia_error": np.array([0.1, 1.0, 10.0]), "rotor_drag": np.array([0.2, 0.0, 0.1])})
    assert at_bounds("inertia_error", params, neutral, ROBOT) == ["sx", "sz"]
    assert at_bounds("rotor_drag", params, np.zeros(3), ROBOT) == []
