"""Winds that remove less of an unexplained residual than remains of it have no name; training flights alone decide."""

from pathlib import Path

import numpy as np
import pytest

from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.identify.selection.select import select_effects
from aerial_gym.sim2real.judge.remainder import effects_below_remainder
from aerial_gym.sim2real.predict.model_params import params_from_robot
from tests.unit.sim2real.flat_flights import flight, load_tables, make_predictor
from tests.unit.sim2real.identify.selection.test_select import DRAGGED


@pytest.mark.parametrize(("push", "below"), [(0.1, False), (0.5, True)])
def test_a_wind_below_the_remainder_of_training_flights_is_none(push: float, below: bool, tmp_path: Path) -> None:
    """Wind adds 0.12 N along x; an unknown push along x and y has amplitude ``push`` [N] and its own phase in each flight."""
    time, tables = np.arange(1200) / 100.0, []
    for seed in range(4):
        waves = np.cos(2.0 * np.pi * np.outer(time, (0.9, 1.3)) + seed)
        outside = push * np.column_stack((waves, np.zeros(1200)))
        tables.append(flight(seed, rate=100.0, noise=1.0, drag=0.3, wind=(0.4, 0.0, 0.0), outside=outside))
    predictor, declared = make_predictor(load_tables(tmp_path, tables, DRAGGED), DRAGGED), params_from_robot(DRAGGED)
    result = select_effects(predictor, declared, Criteria(), candidates=("constant_wind", "rotor_drag"))
    assert result.effect_names == ("constant_wind",)
    reasons = effects_below_remainder(predictor, declared, result)
    assert [(name, reason.code) for name, reason in reasons.items()] == [("constant_wind", "remainder_larger")] * below
