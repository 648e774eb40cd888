"""One policy for many vehicles: actions that are shares of what rotors can be told, and a robot that every episode draws."""

from dataclasses import replace
from itertools import product
from math import copysign

import pytest
import torch

from aerial_gym import ROBOTS, task_registry
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.task.rotor_range import quadrotor_to_rotors_matrix, rotor_order, with_rotor_range
from tests.refusals import assert_refused
from tests.repetitions import frequent_values
from tests.unit.task.hover import begin

NAME = "any_quadrotor_task"


@pytest.mark.parametrize(("robot", "controller", "low", "high"), [
    (None, None, 0.0, (2.0 / 3.485449e-7) ** 0.5),  # 2 N [rad/s]
    ("tinyprop", None, (0.2 / 3.25852e-7) ** 0.5, (1.2 / 3.25852e-7) ** 0.5),
    ("x500", "no_control", 0.0, 20.0),  # N
])  # fmt: skip
def test_an_action_is_a_share_of_what_the_rotors_can_be_told(robot, controller, low, high) -> None:
    with begin(NAME, 2, robot=robot, controller=controller) as task:
        for action, expected in ((-1.0, low), (0.0, 0.5 * (low + high)), (1.0, high)):
            task.step(torch.full((2, 4), action))
            told = task.env.gtd["robot_actions"]
            torch.testing.assert_close(told, torch.full((2, 4), expected), rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("robot", ["base_quadrotor", "x500"])
def test_an_action_goes_to_the_rotor_at_its_place(robot: str) -> None:
    places = ((1, -1), (-1, -1), (-1, 1), (1, 1))
    mounts = ROBOTS.get(robot).mounts.layout
    with begin(NAME, 1, robot=robot) as task:
        task.step(torch.tensor([[-0.5, 0.0, 0.5, 1.0]]))
        told = task.env.gtd["robot_actions"][0].argsort().argsort()
    signs = [(int(copysign(1.0, x)), int(copysign(1.0, y))) for x, y, _ in (mount.position for mount in mounts)]
    assert told.tolist() == [places.index(sign) for sign in signs]


def test_places_are_counted_clockwise_from_the_nose() -> None:
    assert rotor_order([(0.0, 1.0, 0.0), (1.0, 1e-9, 0.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)]) == (3, 0, 1, 2)
    assert rotor_order([(1.0, -1.0, 0.1), (1.0, -1.0, -0.1), (-1.0, -1.0, 0.0)]) == (0, 1, 2)


def test_a_vehicle_that_spins_away_is_lost_before_it_is_infinite() -> None:
    """Full thrust on the right of every vehicle: an episode ends as a crash where a step leads beyond 35 rad/s."""
    with begin(NAME, 500) as task:
        crashed, fastest = torch.zeros(500, dtype=torch.bool), torch.zeros(())
        for _ in range(60):
            *_, info = task.step(torch.tensor([[1.0, 1.0, -1.0, -1.0]]).expand(500, 4).contiguous())
            crashed |= info["crashes"]
            fastest = fastest.maximum(task.env.gtd["robot_body_angvel"].norm(dim=-1).max())
    assert crashed.float().mean() > 0.9
    assert 30.0 < float(fastest) <= 35.0


def test_every_episode_draws_a_vehicle_of_thrust_to_weight_from_1_15_to_7() -> None:
    """What the robot has at full thrust, 3.26, times the factor that is drawn; another one in the next episode."""
    robot = ROBOTS.get("sampled_quadrotor")
    own = 4.0 * robot.the_rotor("the test").thrust_range[1] / (robot.body.mass * 9.81)
    with begin(NAME, 2000) as task:
        first = {name: drawn.clone() for name, drawn in task.env.draws().items()}
        ratio = own * first["rotor.thrust_map"].flatten(1)[:, -1]
        assert 1.149 < float(ratio.min()) < 1.2
        assert 6.7 < float(ratio.max()) < 7.01
        task.reset()
        assert float((task.env.draws()["body.inertia"] != first["body.inertia"]).float().mean()) > 0.99


@pytest.mark.parametrize(
    ("controller", "robot"),
    frequent_values(
        product(
            ("rotor_speed_control", "no_control"),
            ("typhoon_hexarotor", "base_octarotor", "tilted_hexarotor", "coaxial_octarotor", "morphy_stiff"),
        ),
        [("rotor_speed_control", "coaxial_octarotor"), ("no_control", "tilted_hexarotor")],
    ),
)
def test_other_rotors_lift_and_turn_as_a_quadrotor_would(controller: str, robot: str) -> None:
    with begin(NAME, 4, robot=robot, controller=controller) as task:
        half = 2.0 * 0.5**0.5 - 1.0
        more = torch.tensor([[0, 0, 0, 0], [1, 1, -1, -1], [-1, 1, 1, -1], [-1, 1, -1, 1]])
        task.step(half + 0.05 * more)
        told = task.env.gtd["robot_actions"].double()
        vehicle = vehicle_from_config(ROBOTS.get(robot), num_envs=4, dtype=torch.float64)
        thrusts = rotor_thrust(vehicle, told) if controller == "rotor_speed_control" else told
        wrench = (allocation_matrix(vehicle, 9.81) @ thrusts.unsqueeze(-1)).squeeze(-1)
    scale = float(wrench[0, 2])
    assert scale > 0.3 * 9.81 * ROBOTS.get(robot).body.mass
    assert float(wrench[0, [0, 1, 3, 4, 5]].abs().max()) < 2e-3 * scale
    change = wrench - wrench[0]
    for row, axis, sign in ((1, 3, -1.0), (2, 4, 1.0), (3, 5, 1.0)):
        assert sign * float(change[row, axis]) > 0.0
        rest = change[row, [k for k in range(6) if k not in (2, axis)]]
        assert float(rest.abs().max()) < 0.1 * abs(float(change[row, axis]))


def test_what_cannot_fly_rotor_by_rotor_is_refused() -> None:
    robot = ROBOTS.get("base_quadrotor")
    places = zip(robot.mounts.layout, (0.2, 0.1, -0.1, -0.2), strict=True)
    row = tuple(replace(mount, position=(x, 0.0, 0.0)) for mount, x in places)
    with pytest.raises(ConfigError, match="cannot lift this robot and turn it about each axis by itself"):
        quadrotor_to_rotors_matrix(replace(robot, mounts=replace(robot.mounts, layout=row)))
    with pytest.raises(ConfigError, match="action rotor_range: controller lee_attitude_control tells no rotors"):
        task_registry.make_task(NAME, num_envs=2, device="cpu", controller="lee_attitude_control")
    cfg = task_registry.get(NAME)
    cfg = replace(cfg, action=replace(cfg.action, params={"places": 6}))
    assert_refused(ConfigError, "expected {places: 4} or none", with_rotor_range, cfg, ROBOTS.get("x500"), ("speed_1",))


@pytest.mark.parametrize(("robot", "joints"), [("snakey6", "yaw_1 velocity, .*"), ("tilt_tricopter", "[a-z_]+ p.*")])
def test_a_robot_that_is_told_joints_as_well_is_refused(robot: str, joints: str) -> None:
    with pytest.raises(ConfigError, match=f"also takes {joints} of its .* position_setpoint_task_reconfigurable"):
        task_registry.make_task(NAME, num_envs=2, device="cpu", robot=robot)
