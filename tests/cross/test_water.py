"""Effects under water: the fused backend against the torch reference."""

from itertools import product

import pytest

from aerial_gym.control import CONTROLLERS
from aerial_gym.robots import ROBOTS
from tests.cross.test_backends import assert_same_flight
from tests.physics.vehicles import lopsided_robot
from tests.repetitions import often

WATER = ("buoyancy", "hull_drag", "added_mass", "added_inertia", "constant_wind")


@pytest.mark.parametrize(
    ("integrator", "effects"),
    often(product(("euler", "rk4"), (("added_mass",), WATER)), [("euler", ("added_mass",)), ("rk4", WATER)]),
)
def test_a_hull_moves_like_torch(integrator: str, effects: tuple[str, ...]) -> None:
    assert_same_flight(lopsided_robot(), CONTROLLERS.get("no_control"), integrator, effects=effects)


def test_a_vehicle_in_water_moves_like_torch() -> None:
    """With reversible rotors in force mode."""
    assert_same_flight(ROBOTS.get("base_octarotor"), CONTROLLERS.get("no_control"), "euler", effects=WATER)
