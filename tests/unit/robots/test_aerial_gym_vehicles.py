"""Vehicles of the Aerial Gym Simulator: where they hover, which way each rotor turns them, and what they carry."""

from dataclasses import replace
from math import pi

import pytest
import torch

from aerial_gym import SimBuilder
from aerial_gym.control.allocation import allocation_matrix
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots import ROBOTS


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

    A rotor on the right rolls it to the left (negative, x forward), one in front pitches it up (negative, y left); the body
    turns against its rotor. The last holds in flight, too: 1 N more from one rotor alone.
    """
    matrix = allocation_matrix(vehicle_from_config(ROBOTS.get("lmf1"), num_envs=1, dtype=torch.float64), 9.81)[0, 3:]
    by_hand = torch.tensor([[-0.1, -0.1, -0.05], [0.1, 0.1, -0.05], [0.1, -0.1, 0.05], [-0.1, 0.1, 0.05]])
    torch.testing.assert_close(matrix.T, by_hand.double())
    env = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="empty_env",
        robot_name="lmf1",
        controller_name="no_control",
        device="cpu",
        num_envs=4,
    )
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


@pytest.mark.parametrize(
    ("robot", "base", "motor", "arm"),
    [("x500", (0.0139, 0.0139, 0.0246), 0.064, 0.174)]
    + [(name, (0.013, 0.014, 0.013), 0.01, 0.1) for name in ("lmf1", "lmf2", "magpie")],
)
def test_the_inertia_is_that_of_the_body_and_its_four_motors(
    robot: str, base: tuple[float, float, float], motor: float, arm: float
) -> None:
    """Steiner: a motor at (±a, ±a) adds m a² about x and y, and 2 m a² about z; to the four digits of the files."""
    inertia = ROBOTS.get(robot).body.inertia
    for axis, share in enumerate((1.0, 1.0, 2.0)):
        expected = base[axis] + 4.0 * motor * share * arm**2
        assert inertia[axis][axis] == pytest.approx(expected, rel=2e-3)
