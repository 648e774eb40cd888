"""What is judged on the test flights, against linear models whose answer is known."""

import numpy as np

from aerial_gym.sim2real.identify.least_squares.gauss_newton import ModelFit
from aerial_gym.sim2real.identify.least_squares.moments import block_moments
from aerial_gym.sim2real.judge.residual_excess import material_excess, with_best_deviations
from aerial_gym.sim2real.predict.model_params import ModelParams


def linear_fit(residual: np.ndarray, jacobian: np.ndarray, *, num_effect_params: int) -> ModelFit:
    """Return a fit of one flight of 10 s, its effects' parameters in front."""
    rows, width = residual.shape[0], jacobian.shape[2]
    return ModelFit(
        effects=("rotor_drag",), params=ModelParams(effects={"rotor_drag": np.full(3, 0.2)}),
        moments=block_moments([np.linspace(0.0, 10.0, rows)], [residual], [jacobian], length=1.0),
        low=np.full(width, -9.0), high=np.full(width, 9.0), num_effect_params=num_effect_params,
    )  # fmt: skip


def test_the_model_that_is_judged_has_the_parameters_of_the_robot_file() -> None:
    """Single steps ask for another drag than the file holds, whose drag came from rollouts: the effects stay as they are
    written, and the deviations solve ``(J^T W J + 1) d = J^T W r`` beside them."""
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((500, 2, 7))
    residual = jacobian @ np.array([0.5, -0.3, 0.2, 1.0, 0.0, -1.0, 2.0]) + 0.1 * rng.standard_normal((500, 2))
    weight, written = np.array([2.0, 0.5]), ModelParams(effects={"rotor_drag": np.array([0.21, 0.2, 0.19])})
    result = with_best_deviations(written, linear_fit(residual, jacobian, num_effect_params=3), weight)
    assert result.effects is written.effects
    root = np.sqrt(weight)[None, :, None]
    columns, values = (jacobian[:, :, 3:] * root).reshape(-1, 4), (residual * root[:, :, 0]).reshape(-1)
    expected = np.linalg.solve(columns.T @ columns + np.eye(4), columns.T @ values)
    np.testing.assert_allclose(result.deviation, expected, rtol=1e-10)


def test_what_remains_is_material_above_noise_and_tolerances() -> None:
    floor, tolerated = np.array([0.02, 0.02, 0.02]), np.array([0.02, 0.02, 0.2])
    rms = np.array([0.024, 0.06, 0.06])  # near the floor; above both; hidden by the tolerances
    assert material_excess(rms, floor, tolerated).tolist() == [False, True, False]
    assert material_excess(rms, None, tolerated).tolist() == [False, False, False]
