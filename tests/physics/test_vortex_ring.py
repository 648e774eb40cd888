"""Loss of thrust in fast descent: closed forms, continuity at both ends, sideways flow, the other direction of thrust."""

from dataclasses import replace
from math import pi, sqrt

import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.physics import BodyState, accelerations, build_model, vehicle_from_config
from aerial_gym.physics.effects.induced_flow import AIR_DENSITY
from aerial_gym.physics.model import check_effects
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import F64, make_effects, rest_state

ROBOT = ROBOTS.get("racing_quadrotor")
SPEED = 1200.0
ROTOR = ROBOT.rotor_types[0]
THRUST = ROTOR.thrust_map[0] + SPEED * (ROTOR.thrust_map[1] + SPEED * ROTOR.thrust_map[2])
HOVER = sqrt(THRUST / (2.0 * AIR_DENSITY * pi * float(ROTOR.radius or 0.0) ** 2) + 1e-6)
"""Induced velocity [m/s], with the least that the effect adds."""


def loss(state: BodyState, k: float = 0.2) -> float:
    vehicle = vehicle_from_config(ROBOT, num_envs=1, dtype=F64)
    models = (build_model(vehicle, make_effects(e, 1)) for e in ({}, {"vortex_ring": {"k": k}}))
    without, with_ring = (accelerations(model, state).specific_force[0, 2] for model in models)
    return float((without - with_ring) * vehicle.mass[0] / (4.0 * THRUST))


def descent_state(ratio: float, across: float = 0.0) -> BodyState:
    return rest_state(lin_vel=[HOVER * across, 0.0, HOVER * ratio], rotor_speed=[SPEED] * 4)


@pytest.mark.parametrize(("ratio", "excess"), [
    (-0.5, 0.5625 - 0.343 + 0.21475 - 0.0409375),
    (-1.0, 1.125 - 1.372 + 1.718 - 0.655),
    (-1.5, 1.6875 - 3.087 + 5.79825 - 3.3159375),
])  # fmt: skip
def test_the_loss_is_the_excess_of_the_measured_inflow(ratio: float, excess: float) -> None:
    """``k (p(x) - 1)``; with ``y = 0.6`` across it is ``(1 - 0.36)²`` of that."""
    assert loss(descent_state(ratio)) == pytest.approx(0.2 * excess, rel=1e-9)
    assert loss(descent_state(ratio, 0.6)) == pytest.approx(0.2 * excess * 0.64**2, rel=1e-9)
    assert loss(descent_state(ratio), k=0.4) == pytest.approx(0.4 * excess, rel=1e-9)


@pytest.mark.parametrize("ratio", [0.0, 0.5, 3.0, -2.006, -3.0, -50.0])
def test_there_is_none_in_hover_climb_and_windmill(ratio: float) -> None:
    assert loss(descent_state(ratio)) == pytest.approx(0.0, abs=1e-12)


def test_it_begins_and_ends_without_a_jump() -> None:
    assert 0.0 < loss(descent_state(-1e-6)) < 0.3e-6
    assert 0.0 < loss(descent_state(-2.0054)) < 0.2 * 5.0 * 1e-4
    assert loss(descent_state(-1.0, 1.0)) == pytest.approx(0.0, abs=1e-12)
    assert loss(descent_state(-1.0, 0.999)) < 2e-6


def test_upside_down_it_is_the_climb_that_counts() -> None:
    """A vehicle turned over whose thrust points down meets its wake where it climbs."""
    over, speeds = [1.0, 0.0, 0.0, 0.0], [SPEED] * 4
    assert loss(rest_state(lin_vel=[0.0, 0.0, HOVER], attitude=over, rotor_speed=speeds)) == pytest.approx(
        0.2 * 0.816, rel=1e-9
    )
    assert loss(rest_state(lin_vel=[0.0, 0.0, -HOVER], attitude=over, rotor_speed=speeds)) == pytest.approx(
        0.0, abs=1e-12
    )


def test_of_a_reversed_rotor_it_is_the_climb_too() -> None:
    """Its wake goes up: rising at one induced velocity it loses 0.816 k of its downward thrust, sinking nothing."""
    square = (0.0, 0.0, THRUST / SPEED**2)
    rotor = replace(ROTOR, thrust_map=square, thrust_range=(-THRUST, THRUST), torque_map=None, torque_ratio=0.01)
    vehicle = vehicle_from_config(replace(ROBOT, rotor=rotor), num_envs=1, dtype=F64)
    models = [build_model(vehicle, make_effects(e, 1)) for e in ({}, {"vortex_ring": {"k": 0.2}})]
    for ratio, expected in ((1.0, 0.2 * 0.816), (-1.0, 0.0)):
        state = rest_state(lin_vel=[0.0, 0.0, HOVER * ratio], rotor_speed=[-SPEED] * 4)
        without, ring = (float(accelerations(m, state).specific_force[0, 2] * vehicle.mass[0]) for m in models)
        assert without == pytest.approx(-4.0 * THRUST)
        assert ring - without == pytest.approx(4.0 * THRUST * expected, rel=1e-9, abs=1e-12)


def test_a_robot_without_radius_is_refused() -> None:
    robot = replace(ROBOT, rotor=replace(ROTOR, radius=None), effects={"vortex_ring": {"k": 0.2}})
    with pytest.raises(ConfigError, match=r"vortex_ring: the robot file must give rotor.radius \[m\]"):
        check_effects(robot)
