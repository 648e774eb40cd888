"""Test of ``my_environment.yaml``: every flight starts clear of obstacles, and none starts with a crash."""

from pathlib import Path

import torch

from aerial_gym import SimBuilder

FILE = Path(__file__).with_name("my_environment.yaml")


def test_flights_start_clear_of_obstacles() -> None:
    names = {"sim_name": "base_sim", "robot_name": "base_quadrotor", "controller_name": "lee_velocity_control"}
    env = SimBuilder().build_env(**names, env_name=str(FILE), num_envs=16, device="cpu")
    env.reset()
    env.step(torch.zeros(16, 4))
    assert (env.gtd["robot_clearance"] > 0.1).all()  # distance to the nearest obstacle or the ground [m], (E,)
    assert not env.gtd["crashes"].any()
