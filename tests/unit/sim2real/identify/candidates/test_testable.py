"""What flights can test: how much of what would show an effect is noise of the logs, and where parameters end."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.identify.candidates.testable import at_bounds, noise_shares
from aerial_gym.sim2real.identify.least_squares.gauss_newton import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.moments import weights_from
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.predict.test_scene import hover

NOISE = 3.0
"""Of each rotor speed [rad/s], about 0.3 %."""


def shares(turn: float, *names: str, noise: float = NOISE, **more: object) -> dict[str, float]:
    """Return the shares of noise in four hovers whose rotors turn the vehicle about x with so many rad/s (rms) of speed."""
    rng, flights = np.random.default_rng(0), []
    for number in range(4):
        still: Flight = hover(f"{number}", 5.0)
        assert still.rotor_speed is not None
        swing = np.sqrt(2.0) * turn * np.sin(2.0 * np.pi * (1.0 + number) * still.time)
        speed = still.rotor_speed + swing[:, None] * np.array([1.0, -1.0, -1.0, 1.0])
        speed = speed + noise * rng.standard_normal(speed.shape)
        rate = still.ang_vel + 3e-4 * rng.standard_normal(still.ang_vel.shape)
        force = np.array([0.0, 0.0, 9.81]) + 0.05 * rng.standard_normal(rate.shape)
        flights.append(replace(still, **{"rotor_speed": speed, "ang_vel": rate, "specific_force": force, **more}))
    predictor = Predictor(ROBOT, flights, bandwidth=10.0, channels=find_channels(flights), tolerances=Tolerances())
    declared = ModelParams()
    tolerance = tolerance_jacobian(predictor, declared, predictor.predict(declared))
    weights = weights_from(predictor.residuals(declared))
    return noise_shares(predictor, declared, names, tolerance, weights.weight)


def test_in_hover_an_inertia_shows_by_noise_alone_and_a_centre_of_mass_by_itself() -> None:
    """The rotors' noise makes all that the inertia would change."""
    found = shares(0.0, "inertia_error", "com_offset")
    assert found["inertia_error"] > 0.5
    assert found["com_offset"] < 0.1


@pytest.mark.parametrize("turn", [3.0, 30.0])
def test_the_share_is_noise_over_noise_and_motion(turn: float) -> None:
    """A sine in opposite rotors beside white noise, of which the band holds 10 of 50 Hz, from one flight of 4 s."""
    in_band = NOISE**2 / 4.0 * 10.0 / 50.0  # four rotors turn together, their noise does not
    found = shares(turn, "inertia_error")
    assert found["inertia_error"] == pytest.approx(in_band / (in_band + turn**2), rel=0.5)


def test_commands_have_no_noise() -> None:
    assert shares(0.0, "inertia_error", rotor_command=np.full((400, 4), 0.5), rotor_speed=None) == {}


def test_a_parameter_that_ends_where_physics_does_is_told() -> None:
    """A drag of 0 along y is where the effect begins, a bound of an inertia is not."""
    neutral = np.ones(3)
    params = ModelParams(effects={"inertia_error": np.array([0.1, 1.0, 10.0]), "rotor_drag": np.array([0.2, 0.0, 0.1])})
    assert at_bounds("inertia_error", params, neutral, ROBOT) == ["sx", "sz"]
    assert at_bounds("rotor_drag", params, np.zeros(3), ROBOT) == []
