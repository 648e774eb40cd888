"""Test of ``my_sensor.yaml``: its images show the ground at plausible distances."""

from dataclasses import replace
from pathlib import Path

from aerial_gym import ROBOTS, SimBuilder
from aerial_gym.config.sensor import load_sensor

FILE = Path(__file__).with_name("my_sensor.yaml")


def test_sensor_sees_the_ground() -> None:
    sensor, robot = load_sensor(FILE), replace(ROBOTS.get("base_quadrotor"), sensors=(str(FILE),))
    names = {"sim_name": "base_sim", "env_name": "landing_env", "controller_name": "lee_velocity_control"}
    env = SimBuilder().build_env(**names, robot_name=robot, num_envs=2, device="cpu")
    env.reset()
    env.render()
    depth = env.gtd["depth_range_pixels"]  # (E, S, H, W) [m]
    assert depth.shape == (2, 1, sensor.height, sensor.width)
    assert (depth > sensor.min_range).any()
    assert (depth <= sensor.max_range).all()
