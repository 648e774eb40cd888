"""Vehicles of the Aerial Gym Simulator: where they hover, which way each rotor turns them, and what they carry."""

from dataclasses import replace
from math import pi

import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.allocation import allocation_matrix
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots import ROBOTS
from tests.builders import simulation


@pytest.mark.parametrize(
    ("robot", "speed"),
    [
        ("lmf1", 742.97),  # 1.235 9.81 / 4 = 3.02884 N = 5.487e-6 w²
        ("lmf2", 2.0 * pi * 470.12),  # 1.24 9.81 / 4 = 3.0411 N = 1.376e-5 n², n in rev/s
        ("lmf2_with_camera", 2.0 * pi * 470.12),
        ("lmf2_radar", 2.0 * pi * 470.12),
        ("magpie", 2.0 * pi * 470.12),
    ],
)
def test_each_hovers_at_the_speed_worked_out_by_hand(robot: str, speed: float) -> None:
    cfg = ROBOTS.get(robot)
    vehicle = vehicle_from_config(cfg, num_envs=1, dtype=torch.float64)
    thrust = rotor_thrust(vehicle, torch.full((1, 4), speed, dtype=torch.float64))
    assert thrust.sum().item() == pytest.approx(9.81 * cfg.body.mass, rel=1e-4)


def test_each_rotor_of_lmf1_turns_it_as_px4_says() -> None:
    """Front right, back left, front left, back right: 0.1 m to the side and 0.05 m of drag torque per newton, by hand.
    A rotor on the right rolls it to the left (negative, x forward), one in front pitches it up (negative, y left); the
    body turns against its rotor. The last holds in flight, too: 1 N more from one rotor alone."""
    matrix = allocation_matrix(vehicle_from_config(ROBOTS.get("lmf1"), num_envs=1, dtype=torch.float64), 9.81)[0, 3:]
    by_hand = torch.tensor([[-0.1, -0.1, -0.05], [0.1, 0.1, -0.05], [0.1, -0.1, 0.05], [-0.1, 0.1, 0.05]])
    torch.testing.assert_close(matrix.T, by_hand.double())
    env = simulation("lmf1", num_envs=4)
    env.reset()
    env.robot_manager.tensors.state.ang_vel.zero_()
    for _ in range(5):
        env.step(3.03 + torch.eye(4))
    turned = env.gtd["robot_body_angvel"].double()
    inertia = torch.tensor([0.013, 0.014, 0.013], dtype=torch.float64)
    assert torch.equal(turned.sign(), by_hand.double().sign())
    direction = torch.nn.functional.normalize(by_hand / inertia, dim=-1)
    torch.testing.assert_close(torch.nn.functional.normalize(turned, dim=-1), direction, rtol=0.0, atol=0.02)


def test_variants_differ_by_their_sensor_alone() -> None:
    lmf2 = ROBOTS.get("lmf2")
    assert lmf2.sensors == ()
    for name, sensor in (("lmf2_with_camera", "base_depth_camera"), ("lmf2_radar", "fake_radar")):
        assert replace(lmf2, sensors=(sensor,), summary=ROBOTS.get(name).summary) == ROBOTS.get(name)
    assert ROBOTS.get("magpie").sensors == ROBOTS.get("base_quadrotor_with_dome_lidar").sensors


RANDOM_MATRIX = (
    (0.0, -0.321393805, -0.454519478, -0.342020143, 0.96984631, 0.342020143, 0.866025404, -0.754406507),
    (1.0, -0.342020143, -0.707106781, 0.0, -0.173648178, 0.939692621, 0.5, -0.173648178),
    (0.0, -0.883022222, 0.54167522, 0.939692621, 0.171010072, 0.0, 0.0, 0.633022222),
    (0.175, 0.123788742, -0.0569783368, 0.134977168, 0.0336959042, -0.266534135, -0.078839746, -0.0206893989),
    (0.01, 0.278845133, -0.0432852308, -0.272061766, -0.197793856, 0.0863687139, 0.156554446, -0.17126129),
    (0.282487373, -0.14173549, -0.0858541103, 0.0384858939, -0.333468026, 0.0836741468, 0.00846777988, -0.0874336259),
)
"""``base_random_config.allocation_matrix`` of Aerial Gym Simulator 2.0.1."""

OCTAROTOR_MATRIX = (
    (-0.78867513, 0.21132487, -0.21132487, 0.78867513, 0.78867513, -0.21132487, 0.21132487, -0.78867513),
    (0.21132487, 0.78867513, -0.78867513, -0.21132487, -0.21132487, -0.78867513, 0.78867513, 0.21132487),
    (0.57735027, -0.57735027, -0.57735027, 0.57735027, 0.57735027, -0.57735027, -0.57735027, 0.57735027),
    (0.14226497, -0.21547005, 0.25773503, 0.01547005, -0.01547005, -0.25773503, 0.21547005, -0.14226497),
    (-0.25773503, 0.01547005, 0.14226497, 0.21547005, -0.21547005, -0.14226497, -0.01547005, 0.25773503),
    (0.11547005, -0.23094011, -0.11547005, 0.23094011, -0.23094011, 0.11547005, 0.23094011, -0.11547005),
)
"""``base_octarotor_config.allocation_matrix`` of the same; its own motors have a tenth of its torque ratio."""


@pytest.mark.parametrize(
    ("name", "torque_ratio", "published"),
    [("base_random", None, RANDOM_MATRIX), ("base_octarotor", 0.1, OCTAROTOR_MATRIX)],
)
def test_the_derived_matrix_is_the_published_one(name: str, torque_ratio: float | None, published) -> None:
    """With 0.1 m in place of the 0.01 m of its motor model all 48 entries of the octarotor agree."""
    robot = ROBOTS.get(name)
    changes = {} if torque_ratio is None else {"rotor": replace(robot.rotor, torque_ratio=torque_ratio)}
    result, expected = vehicle_matrix(replace(robot, **changes)), torch.tensor(published, dtype=torch.float64)
    torch.testing.assert_close(result, expected, rtol=0.0, atol=1e-6 if changes else 1e-7)
    assert not changes or (vehicle_matrix(robot) - expected).abs().max() > 0.05


def vehicle_matrix(robot: RobotCfg) -> torch.Tensor:
    return allocation_matrix(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), 9.81)[0]


@pytest.mark.parametrize("robot", ["base_octarotor", "base_random", "tilted_hexarotor", "omnidirectional_octarotor"])
def test_fully_actuated_robots_push_and_turn_about_every_axis(robot: str) -> None:
    """Rank 6, with the smallest singular value a hundred times above round-off."""
    size = torch.linalg.svdvals(vehicle_matrix(ROBOTS.get(robot)))
    assert size[5] > 0.01 * size[0]


@pytest.mark.parametrize("robot", ["typhoon_hexarotor", "coaxial_octarotor", "racing_quadrotor"])
def test_flat_robots_push_along_one_axis(robot: str) -> None:
    matrix = vehicle_matrix(ROBOTS.get(robot))
    assert int(torch.linalg.matrix_rank(matrix, rtol=1e-9)) == 4
    torch.testing.assert_close(matrix[:3].sum(1)[:2], torch.zeros(2, dtype=torch.float64))
