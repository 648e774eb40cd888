"""What is drawn of effects that were not named."""

from aerial_gym.sim2real.report.figures import most_probable_single_effects
from tests.unit.sim2real.set_fits import PLACE, make_choice, make_fit, make_selection


def test_only_single_effects_that_were_fitted_are_drawn() -> None:
    nowhere = make_fit("slung_payload", log=float("-inf"))
    drag = make_fit("rotor_drag", log=-5.0, odds={"rotor_drag": -1.0})
    beside, pair = make_fit("imu_bias", log=-1.0, structures=(PLACE,)), make_fit("imu_bias", "com_offset", log=-2.0)
    assert most_probable_single_effects(make_selection(make_choice(make_fit(), nowhere, drag, beside, pair))) == [drag]
    more = [make_fit("com_offset", log=-4.0), make_fit("motor_tilt", log=-6.0)]
    shown = most_probable_single_effects(make_selection(make_choice(make_fit(), drag, *more)))
    assert [one.effects[0] for one in shown] == ["com_offset", "rotor_drag"]
