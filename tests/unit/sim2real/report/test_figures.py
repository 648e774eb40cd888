"""What is drawn of effects that were not named."""

from aerial_gym.sim2real.report.figures import closest
from tests.unit.sim2real.fitted_sets import PLACE, chosen_of, fitted, selection_of


def test_only_single_effects_that_were_fitted_are_drawn() -> None:
    """The two most probable ones, not a pendulum whose fit went nowhere, for which nothing can be predicted."""
    nowhere, drag = (
        fitted("slung_payload", log=float("-inf")),
        fitted("rotor_drag", log=-5.0, odds={"rotor_drag": -1.0}),
    )
    beside, pair = fitted("imu_bias", log=-1.0, structures=(PLACE,)), fitted("imu_bias", "com_offset", log=-2.0)
    assert closest(selection_of(chosen_of(fitted(), nowhere, drag, beside, pair))) == [drag]
    more = [fitted("com_offset", log=-4.0), fitted("motor_tilt", log=-6.0)]
    assert [one.effects[0] for one in closest(selection_of(chosen_of(fitted(), drag, *more)))] == [
        "com_offset",
        "rotor_drag",
    ]
