"""Position and attitude by themselves: vehicles whose rotors push in every direction, in air and under water."""

from math import pi

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.robots import ROBOTS


def flown(robot: str, controller: str, actions: torch.Tensor, steps: int) -> EnvManager:
    env = EnvManager(
        sim=SIMS.get("base_sim"),
        env=ENVIRONMENTS.get("empty_env"),
        robot=ROBOTS.get(robot),
        controller=CONTROLLERS.get(controller),
        num_envs=len(actions),
        device=torch.device("cpu"),
        seed=0,
    )
    env.reset()
    for _ in range(steps):
        env.step(actions)
    return env


@pytest.mark.parametrize(
    ("robot", "within"),
    [("base_octarotor", 0.01), ("base_rov", 0.01), pytest.param("bluerov2_heavy", 0.1, marks=pytest.mark.slow)],
)
def test_a_place_is_held_in_any_attitude(robot: str, within: float) -> None:
    """Level, on its side, nose up and nearly upside down, at one and the same place; q and -q are one attitude.

    The centre of buoyancy of the BlueROV2, 1 cm above that of mass, rights it with 1.3 N m, which a law without an integral
    answers with an error: 1.3 N m over its gain, some 0.1 rad.
    """
    euler = torch.tensor([[0.0, 0.0, 0.0], [pi / 2, 0.0, 0.0], [0.0, -1.2, 0.5], [2.7, 0.0, 0.0]])
    wanted = quat_from_euler(euler)
    place = torch.tensor([[0.3, -0.2, 0.1]]).expand(4, -1)
    env = flown(robot, "fully_actuated_control", torch.cat((place, wanted), dim=-1), 1500)
    assert (env.gtd["robot_position"] - place).norm(dim=-1).max() < 0.03
    half = torch.acos((env.gtd["robot_orientation"] * wanted).sum(-1).abs().clamp(max=1.0))
    assert 2.0 * half.max() < within


def test_a_heading_is_steered_while_a_velocity_is_held() -> None:
    """1 m/s along the vehicle's own x at a yaw of 0.8 rad: the world velocity has that direction."""
    env = flown("lmf1", "lee_velocity_steering_angle_control", torch.tensor([[1.0, 0.0, 0.0, 0.8]]), 600)
    assert env.gtd["robot_euler_angles"][0, 2].item() == pytest.approx(0.8, abs=1e-3)
    expected = torch.tensor([0.8]).cos().item(), torch.tensor([0.8]).sin().item()
    assert env.gtd["robot_linvel"][0, :2].tolist() == pytest.approx(expected, abs=1e-3)
