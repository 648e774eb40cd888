"""Position and attitude by themselves: vehicles whose rotors push in every direction, in air and under water."""

from math import pi

import pytest
import torch

from aerial_gym.control import CONTROLLERS
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.gains import make_gains
from aerial_gym.env_manager import EnvManager
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate_inverse
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.builders import simulation


def fly(robot: str, controller: str, actions: torch.Tensor, steps: int) -> EnvManager:
    env = simulation(robot, controller, num_envs=len(actions))
    env.reset()
    for _ in range(steps):
        env.step(actions)
    return env


@pytest.mark.parametrize(
    "robot", ["base_octarotor", "base_rov", pytest.param("bluerov2_heavy", marks=pytest.mark.slow)]
)
def test_a_place_is_held_in_any_attitude(robot: str) -> None:
    """Level, on its side, nose up and nearly upside down, at one and the same place; q and -q are one attitude. A centre of
    buoyancy above that of mass rights the vehicle, which a law without an integral answers with an error e about each body
    axis: ``K_i sin e = (r x B)_i``; some 0.03 rad for ``base_rov`` (0.11 N m), 0.1 rad for the BlueROV2 (1.3 N m)."""
    euler = torch.tensor([[0.0, 0.0, 0.0], [pi / 2, 0.0, 0.0], [0.0, -1.2, 0.5], [2.7, 0.0, 0.0]])
    wanted = quat_from_euler(euler)
    place = torch.tensor([[0.3, -0.2, 0.1]]).expand(4, -1)
    env = fly(robot, "fully_actuated_control", torch.cat((place, wanted), dim=-1), 1500)
    attitude = env.gtd["robot_orientation"]
    assert (env.gtd["robot_position"] - place).norm(dim=-1).max() < 0.03
    half = torch.acos((attitude * wanted).sum(-1).abs().clamp(max=1.0))
    torch.testing.assert_close(torch.sin(2.0 * half), lean_angle(robot, attitude), rtol=0.0, atol=ATTITUDE)


ATTITUDE = 1e-3
"""[rad]: a float32 cosine of half an angle that is one spacing (6e-8) below one belongs to an angle of 7e-4."""


def lean_angle(name: str, attitude: torch.Tensor) -> torch.Tensor:
    """Return the sine of the angle at which attitude gains hold a buoyancy's moment, (E,); 0 without buoyancy."""
    cfg = ROBOTS.get(name)
    buoyancy = cfg.effects.get("buoyancy", dict.fromkeys(("force", "x", "y", "z"), 0.0))
    vehicle = vehicle_from_config(cfg, num_envs=1, dtype=torch.float32)
    gains = make_gains(
        CONTROLLERS.get("fully_actuated_control"), cfg.control, vehicle, Allocation(vehicle, 9.81), gravity=9.81,
        dt=0.01,
    )  # fmt: skip
    up = quat_rotate_inverse(attitude, torch.tensor([[0.0, 0.0, buoyancy["force"]]]).expand(len(attitude), -1))
    lever = torch.tensor([[buoyancy[axis] for axis in "xyz"]]).expand_as(up)
    return (torch.linalg.cross(lever, up) / gains.attitude).norm(dim=-1)


def test_a_heading_is_steered_while_a_velocity_is_held() -> None:
    """1 m/s along the vehicle's own x at a yaw of 0.8 rad: the world velocity has that direction."""
    env = fly("lmf1", "lee_velocity_steering_angle_control", torch.tensor([[1.0, 0.0, 0.0, 0.8]]), 600)
    assert env.gtd["robot_euler_angles"][0, 2].item() == pytest.approx(0.8, abs=1e-3)
    expected = torch.tensor([0.8]).cos().item(), torch.tensor([0.8]).sin().item()
    assert env.gtd["robot_linvel"][0, :2].tolist() == pytest.approx(expected, abs=1e-3)
