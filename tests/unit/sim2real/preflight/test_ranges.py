"""Motion outside the training, and the robot of the training."""

from dataclasses import replace

import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.preflight.ranges import TrainingConditions


def test_a_policy_of_another_robot_is_refused_with_the_parts_that_differ() -> None:
    trained = robot_by_name("base_quadrotor")
    conditions = TrainingConditions(robot=trained, source="runs/hover")
    conditions.check_robot(replace(trained, summary="the same in other words", sensors=()))
    TrainingConditions().check_robot(trained)
    heavier = replace(trained, body=replace(trained.body, mass=2.0 * trained.body.mass))
    with pytest.raises(ConfigError, match=r"runs/hover: was trained on a robot with other mass or inertia \("):
        conditions.check_robot(heavier)
    with pytest.raises(ConfigError, match=r"other mass or inertia, rotors, mounts.*train --robot"):
        conditions.check_robot(robot_by_name("x500"))
