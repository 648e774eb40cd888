"""What flights can test: effects that need torques, and where parameters end."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect, parameters_at_bounds
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.predict.test_scene import hover


@pytest.mark.parametrize("name", ["com_offset", "motor_tilt"])
def test_what_torques_tell_is_not_looked_for_where_none_are_compared(name: str) -> None:
    whole = hover("a", 5.0)
    without = replace(whole, gyro=False)
    assert finding_on_untestable_effect(name, ROBOT, [whole], [whole]) is None
    for train, test in (([whole, without], [whole]), ([whole], [without])):
        assert finding_on_untestable_effect(name, ROBOT, train, test) == Finding("torques_not_compared", name)
    assert finding_on_untestable_effect("rotor_drag", ROBOT, [without]) is None


@pytest.mark.parametrize("name", ["motor_time_constant", "motor_asymmetry"])
def test_a_lag_is_not_looked_for_in_commands_logged_more_slowly_than_rotors_follow(name: str) -> None:
    """40 ms declared: rows of 25 and of 50 Hz. Delays and gains, and lags of flights without commands, are other matters."""
    flight = hover("a", 5.0)
    slow, quick = (
        replace(flight, rate=rate, rotor_command=np.full((flight.num_rows, 4), 900.0)) for rate in (25.0, 50.0)
    )
    assert finding_on_untestable_effect(name, ROBOT, [quick]) is None
    reason = finding_on_untestable_effect(name, ROBOT, [quick, slow])
    assert (reason.code, reason.values) == ("commands_too_coarse", pytest.approx({"row_ms": 40.0, "lag_ms": 40.0}))
    assert (
        finding_on_untestable_effect("actuation_delay", ROBOT, [slow])
        is finding_on_untestable_effect("thrust_coefficient", ROBOT, [slow])
        is None
    )
    assert finding_on_untestable_effect(name, ROBOT, [replace(slow, rotor_command=None)]) is None


@pytest.mark.parametrize("name", ["rotor_drag", "h_force_flapping", "axial_inflow", "constant_wind"])
def test_what_air_does_is_not_looked_for_where_the_speed_through_it_is_unknown(name: str) -> None:
    """Hubs move as a vehicle turns, and that alone would fit them a coefficient."""
    whole = hover("a", 5.0)
    assert finding_on_untestable_effect(name, ROBOT, [whole]) is None
    reason = finding_on_untestable_effect(name, ROBOT, [whole, replace(whole, lin_vel=None)])
    assert (reason.code, reason.values["need"]) == ("logs_lack", "lin_vel")
    assert finding_on_untestable_effect("thrust_coefficient", ROBOT, [replace(whole, lin_vel=None)]) is None


def test_a_parameter_that_ends_where_physics_does_is_told() -> None:
    """A drag of 0 along y is where the effect begins, a bound of an inertia is not."""
    neutral = np.ones(3)
    params = ModelParams(effects={"inertia_error": np.array([0.1, 1.0, 10.0]), "rotor_drag": np.array([0.2, 0.0, 0.1])})
    assert parameters_at_bounds("inertia_error", params, neutral, ROBOT) == ["sx", "sz"]
    assert parameters_at_bounds("rotor_drag", params, np.zeros(3), ROBOT) == []
