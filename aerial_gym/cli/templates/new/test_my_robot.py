"""Test of ``my_robot.yaml``: the robot can fly as described, and hovers at once."""

from pathlib import Path

import torch

from aerial_gym import SimBuilder
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.robots.check import check_robot

FILE = Path(__file__).with_name("my_robot.yaml")


def test_robot_can_fly_as_described() -> None:
    assert check_robot(robot_by_name(FILE), name=FILE.name, controllers=()).problems == ()


def test_robot_flies_to_a_point_and_hovers() -> None:
    names = {"sim_name": "base_sim", "env_name": "empty_env", "controller_name": "lee_position_control"}
    env = SimBuilder().build_env(**names, robot_name=str(FILE), num_envs=4, device="cpu")
    env.reset()
    point = env.gtd["robot_position"] + 0.5  # (E, 3) [m]
    for _ in range(1000):  # 10 s
        env.step(torch.cat((point, torch.zeros(4, 1)), dim=-1))
    assert ((env.gtd["robot_position"] - point).norm(dim=-1) < 0.05).all()
