"""Effects on inertial sensors against the kinematic channels of made readings."""

from types import SimpleNamespace

import numpy as np
import pytest

from aerial_gym.sim2real.identify.selection.kinematics import effects_against_kinematics
from aerial_gym.sim2real.identify.selection.set_search import SetSearch
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import PredictorStub
from tests.unit.sim2real.set_fits import make_fit

TURN = "imu_misalignment"


def make_gyro(true: float) -> PredictorStub:
    """Return gyro readings about z of random turns about y, with a misalignment of the gyro of ``true`` rad."""
    rng = np.random.default_rng(0)
    turns = [rng.standard_normal((900, 1)) for _ in range(3)]
    measured = [true * turn + 0.02 * rng.standard_normal(turn.shape) for turn in turns]

    def predict(params: ModelParams) -> list[np.ndarray]:
        return [params.effects.get(TURN, np.zeros(3))[1] * turn for turn in turns]

    return PredictorStub(predict, measured, channels=(Channel(kind="kinematic_rate", axis="z"),))


@pytest.mark.parametrize(("true", "against"), [(0.0, True), (0.05, False)])
def test_an_imu_effect_that_worsens_the_kinematic_channels_is_refused(true: float, against: bool) -> None:
    params = make_fit(TURN, params={TURN: (0.0, 0.05, 0.0)}).params
    results = effects_against_kinematics(make_gyro(true), params, (TURN,), ModelParams())
    assert [finding.code for finding in results.values()] == (["kinematics_disagree"] if against else [])
    assert effects_against_kinematics(make_gyro(true), params, (), ModelParams()) == {}


def test_the_search_goes_on_from_its_best_set_without_a_refused_effect() -> None:
    """Both effects are in the best set; the gyro is not misaligned. Drag starts at its value of that set."""
    search, starts = object.__new__(SetSearch), []
    search.predictor, search.declared, search.refused = make_gyro(0.0), ModelParams(), {}
    search.allow_effects((TURN, "rotor_drag", "payload_mass"))
    fitted = make_fit(TURN, "rotor_drag", params={TURN: (0.0, 0.05, 0.0), "rotor_drag": (0.1, 0.2, 0.3)})
    search.view = SimpleNamespace(present=fitted, fitter=SimpleNamespace(weights="same"))

    def view_of_supported_set(params, effects, structures, weights) -> SimpleNamespace:
        starts.append((params.effects, weights))
        return SimpleNamespace(present=make_fit(*effects))

    search.climb_to_best_set, search.view_of_supported_set = (lambda _: None), view_of_supported_set
    search.climb_to_allowed_set(())
    assert search.view.present.effects == ("rotor_drag",)
    assert [finding.code for finding in search.refused.values()] == ["kinematics_disagree"]
    assert search.names == search.allowed == ("rotor_drag", "payload_mass")
    assert TURN in search.skipped
    ((effects, weights),) = starts
    assert effects.keys() == {"rotor_drag"}
    assert weights == "same"
    np.testing.assert_array_equal(effects["rotor_drag"], (0.1, 0.2, 0.3))
