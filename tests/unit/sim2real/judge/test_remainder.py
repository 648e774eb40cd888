"""Effects that remove less of an unexplained residual than remains of it have no name."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.judge.remainder import effects_below_remainder
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import PredictorStub
from tests.unit.sim2real.judge.builders import FORCES, make_excess
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection


@pytest.mark.parametrize(
    ("name", "removed", "remains", "open_channels", "dropped"),
    [
        ("constant_wind", (0.0, 0.0, 1.0), (0.1, 0.1, 2.0), ("specific_force.z",), True),
        ("constant_wind", (0.0, 0.0, 2.0), (0.1, 0.1, 1.0), ("specific_force.z",), False),
        ("constant_wind", (0.0, 0.0, 1.0), (0.1, 0.1, 2.0), (), False),  # explained: the rest is noise
        ("constant_wind", (0.3, 0.0, 1.0), (0.1, 0.1, 2.0), ("specific_force.z",), False),  # another channel shows it
        ("inertia_error", (0.0, 0.0, 1.0), (0.1, 0.1, 2.0), ("specific_force.z",), False),  # a value of the vehicle
    ],
)
def test_a_remainder_that_is_larger_leaves_no_name(name, removed, remains, open_channels, dropped) -> None:
    """Residuals (rms) along x, y, z without and with the effect; the noise floor is 0.1."""
    size = np.sqrt(np.square(remains) + np.square(removed))

    def predict(params: ModelParams) -> list[np.ndarray]:
        return [-np.tile(np.array(remains) if params.effects else size, (300, 1))]

    train = PredictorStub(predict, [np.zeros((300, 3))], channels=FORCES)
    weights = Weighting(variance=np.square(remains), effective=np.full(3, 0.3))
    chosen = replace(make_choice(make_fit(name), without={name: make_fit()}), weights=weights)
    excess = make_excess(channels=open_channels, floor=np.full(3, 0.1))
    results = effects_below_remainder(train, make_selection(chosen), excess)
    assert [(one, reason.code) for one, reason in results.items()] == [(name, "remainder_larger")] * dropped
