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
    ("removed", "remains", "open_channels", "dropped"),
    [
        ((0.0, 0.0, 1.0), (0.1, 0.1, 2.0), ("specific_force.z",), True),
        ((0.0, 0.0, 2.0), (0.1, 0.1, 1.0), ("specific_force.z",), False),
        ((0.0, 0.0, 1.0), (0.1, 0.1, 2.0), (), False),  # explained: the rest is noise
        ((0.3, 0.0, 1.0), (0.1, 0.1, 2.0), ("specific_force.z",), False),  # another channel shows it
    ],
)
def test_a_remainder_that_is_larger_leaves_no_name(removed, remains, open_channels, dropped) -> None:
    """Residuals (rms) along x, y, z without and with the effect; the noise floor is 0.1."""
    size = np.sqrt(np.square(remains) + np.square(removed))

    def predict(params: ModelParams) -> list[np.ndarray]:
        return [-np.tile(np.array(remains) if params.effects else size, (300, 1))]

    train = PredictorStub(predict, [np.zeros((300, 3))], channels=FORCES)
    weights = Weighting(variance=np.square(remains), effective=np.full(3, 0.3))
    chosen = replace(make_choice(make_fit("constant_wind"), without={"constant_wind": make_fit()}), weights=weights)
    excess = make_excess(channels=open_channels, floor=np.full(3, 0.1))
    results = effects_below_remainder(train, make_selection(chosen), excess)
    assert {name: reason.code for name, reason in results.items()} == (
        {"constant_wind": "remainder_larger"} if dropped else {}
    )
