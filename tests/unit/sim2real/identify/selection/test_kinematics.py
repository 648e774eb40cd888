"""Effects on inertial sensors against the kinematic channels of made readings."""

from types import SimpleNamespace

import numpy as np
import pytest

from aerial_gym.sim2real.identify.least_squares.derivative_sums import split_columns
from aerial_gym.sim2real.identify.selection.kinematics import effects_against_kinematics
from aerial_gym.sim2real.identify.selection.set_search import SetSearch
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import PredictorStub
from tests.unit.sim2real.set_fits import make_fit

TURN = "imu_misalignment"


def make_fitter(true: float, attitude: float = 0.0) -> SimpleNamespace:
    """Return a fitter for a gyro misaligned by ``true`` rad; the attitude is off by ``attitude``, and may be by 0.01."""
    rng = np.random.default_rng(0)
    turns = [rng.standard_normal((900, 1)) for _ in range(3)]
    measured = [(true - attitude) * turn + 0.02 * rng.standard_normal(turn.shape) for turn in turns]

    def predict(params: ModelParams) -> list[np.ndarray]:
        return [params.effects.get(TURN, np.zeros(3))[1] * turn for turn in turns]

    predictor = PredictorStub(predict, measured, channels=(Channel(kind="kinematic_rate", axis="z"),))
    columns = split_columns([-0.01 * turn[:, :, None] for turn in turns])
    weights = SimpleNamespace(weight=np.full(1, 0.02**-2))
    return SimpleNamespace(
        predictor=predictor, declared=ModelParams(), weights=weights, tolerance_columns=lambda: columns
    )


@pytest.mark.parametrize(
    ("true", "attitude", "against"), [(0.0, 0.0, True), (0.05, 0.0, False), (0.02, 0.02, False), (0.02, 0.013, False)]
)
def test_an_imu_effect_that_worsens_the_kinematic_channels_is_refused(
    true: float, attitude: float, against: bool
) -> None:
    """A logged attitude that is turned with the gyro, by two tolerances, leaves nothing to see, and contradicts nothing."""
    params = make_fit(TURN, params={TURN: (0.0, true or 0.05, 0.0)}).params
    results = effects_against_kinematics(make_fitter(true, attitude), params, (TURN,))
    assert [finding.code for finding in results.values()] == (["kinematics_disagree"] if against else [])
    assert effects_against_kinematics(make_fitter(true, attitude), params, ()) == {}


@pytest.mark.parametrize("leads", [False, True])
def test_the_search_goes_on_from_its_best_set_without_a_refused_effect(leads: bool) -> None:
    """Both effects are in the best set, or lead beside it; the gyro is not misaligned. Drag starts at its present value."""
    search, starts = object.__new__(SetSearch), []
    fitter = make_fitter(0.0)
    search.predictor, search.declared, search.refused = fitter.predictor, ModelParams(), {}
    search.allow_effects((TURN, "rotor_drag", "payload_mass"))
    fitted = make_fit(TURN, "rotor_drag", params={TURN: (0.0, 0.05, 0.0), "rotor_drag": (0.1, 0.2, 0.3)})
    drag = make_fit("rotor_drag", params={"rotor_drag": (0.1, 0.2, 0.3)})
    search.progress, search.best_relinearised_fit = (
        (lambda *_: None),
        lambda view: fitted if fitted.label in view.own else view.present,
    )
    search.view = SimpleNamespace(
        present=drag if leads else fitted, own={fitted.label: fitter}, fits={}, gone=[], fitter=fitter
    )

    def view_of_supported_set(params, effects, structures, weights) -> SimpleNamespace:
        starts.append((params.effects, weights))
        made = make_fit(*effects)
        return SimpleNamespace(present=made, own={made.label: fitter}, fits={}, gone=[])

    search.view_of_supported_set = view_of_supported_set
    search.climb_to_best_set(())
    assert search.view.present.effects == ("rotor_drag",)
    assert [finding.code for finding in search.refused.values()] == ["kinematics_disagree"]
    assert search.names == search.allowed == ("rotor_drag", "payload_mass")
    assert TURN in search.skipped
    ((effects, weights),) = starts
    assert effects.keys() == {"rotor_drag"}
    assert weights is fitter.weights
    np.testing.assert_array_equal(effects["rotor_drag"], (0.1, 0.2, 0.3))
