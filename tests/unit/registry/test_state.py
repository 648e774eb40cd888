"""Digests of configurations."""

from dataclasses import replace

import torch

from aerial_gym.registry.state import config_digest
from aerial_gym.robots import ROBOTS


def test_a_digest_sees_every_number_of_a_robot_with_a_short_text() -> None:
    robot = ROBOTS.get("base_quadrotor")
    other = replace(robot, collision=replace(robot.collision, source="another"))
    assert repr(robot) == repr(other)
    assert not torch.equal(config_digest(robot), config_digest(other))
    assert torch.equal(config_digest(robot), config_digest(replace(robot)))
