"""Steps under the flights of others are those of a fit that has never seen the own ones."""

import numpy as np

from aerial_gym.sim2real.identify.least_squares.gauss_newton import ModelFit, best_step
from aerial_gym.sim2real.identify.least_squares.leave_out import leave_out_steps
from aerial_gym.sim2real.identify.least_squares.moments import block_moments
from aerial_gym.sim2real.predict.model_params import ModelParams

OWN, TOLERANCES = 3, 2


def fit_of_noise() -> ModelFit:
    rng = np.random.default_rng(0)
    times = [np.arange(rows) / 50.0 for rows in (310, 120, 250)]
    residuals = [rng.normal(size=(time.size, 2)) for time in times]
    jacobians = [rng.normal(size=(time.size, 2, OWN + TOLERANCES)) for time in times]
    return ModelFit(
        effects=("rotor_drag",), params=ModelParams(effects={"rotor_drag": np.zeros(3)}),
        moments=block_moments(times, residuals, jacobians, length=1.0), low=np.full(OWN + TOLERANCES, -0.02),
        high=np.full(OWN + TOLERANCES, 5.0), num_effect_params=OWN,
    )  # fmt: skip


def test_each_flight_is_left_out_of_its_own_step() -> None:
    fit, weight = fit_of_noise(), np.array([1.0, 4.0])
    label = 10 * fit.moments.flight
    result = leave_out_steps(fit, weight, fit.free_all, label)
    for flight in range(3):
        expected = best_step(fit, weight, fit.free_all, np.flatnonzero(fit.moments.flight != flight))
        own = result[fit.moments.flight == flight]
        np.testing.assert_allclose(own, np.tile(expected, (len(own), 1)), atol=1e-12)
