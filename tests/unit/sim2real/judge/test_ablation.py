"""The errors of the test flights without a named effect, by predictions that are written down."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.judge.ablation import ablations_of_effects
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import ROBOT, PredictorStub
from tests.unit.sim2real.judge.builders import make_evaluation
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection

FORCE = (Channel(kind="specific_force", axis="z"),)
RAMP = np.linspace(0.0, 1.0, 600)[:, None]  # Share of the charge that is gone


def predict(params: ModelParams) -> list[np.ndarray]:
    """Return the force of three flights [m/s²]: it falls with the charge by the gain, and a deviation of the mass raises it."""
    gain = float(params.effects.get("battery_sag", np.zeros(1))[0])
    offset = 0.0 if params.deviation is None else float(params.deviation[0])
    return [offset - gain * RAMP] * 3


@pytest.mark.parametrize(("offset", "without"), [(0.0, -0.5), (0.6, 0.1)])
def test_an_effect_is_material_also_where_an_error_of_the_declared_mass_hides_it(offset: float, without: float) -> None:
    """The battery takes 1 m/s². With 0.6 m/s² too much thrust from the start, the declared model looks better without it.

    Noise of 0.3 m/s²; without the effect the best mass leaves a line of rms 0.29 m/s².
    """
    rng = np.random.default_rng(3)
    measured = [offset - RAMP + 0.3 * rng.standard_normal(RAMP.shape) for _ in range(3)]
    train, test = (PredictorStub(predict, measured, channels=FORCE) for _ in range(2))
    sagging = replace(make_fit("battery_sag", params={"battery_sag": [1.0]}), deviation=np.array([offset]))
    bare = replace(make_fit(log=-50.0), deviation=np.array([without]))
    selection = make_selection(make_choice(sagging, bare, without={"battery_sag": bare}))
    models, evaluations = (ModelParams(), sagging.params), (make_evaluation(0.4, channels=FORCE),) * 2
    left = test.residuals(sagging.model_with_deviations)
    result = ablations_of_effects(ROBOT, (), (train, test), models, evaluations, selection, left)["battery_sag"]
    assert result.material is True
    alone, final = (np.concatenate(test.residuals(ModelParams(effects=one))) for one in ({}, sagging.params.effects))
    rise = np.sqrt(np.mean(alone**2) / np.mean(final**2)) - 1.0
    assert (rise < 0.0) == (offset > 0.0)
    assert result.largest_rise[1].value == pytest.approx(max(rise, np.hypot(0.29, 0.3) / 0.3 - 1.0), rel=0.1)
    assert result.octaves[0] > 0.5
