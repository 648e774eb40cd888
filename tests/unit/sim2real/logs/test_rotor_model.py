"""Rotors of a declared robot in the identification: mixed types, and those that logs cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.logs.rotor_model import rotor_drag_torques, rotor_thrusts, total_rotor_force
from tests.physics.rotor_types import FORCE, PLAIN, three_type_robot, with_rotor
from tests.physics.vehicles import asymmetric_robot


def test_each_rotor_has_the_map_of_its_own_type() -> None:
    """Reversible, plain, force mode, reversible: -2e-6 w² - 1e-4 w backwards, the polynomial, the state, 3e-6 w²."""
    speed = np.array([[-100.0, 100.0, 3.0, 100.0]])
    np.testing.assert_allclose(
        rotor_thrusts(three_type_robot(), speed), [[-0.03, 0.02 + 0.01 + 0.03, 3.0, 0.03]], rtol=1e-12
    )
    np.testing.assert_allclose(
        rotor_drag_torques(three_type_robot(), speed)[0, [0, 2]], [-0.015 * 0.03, 0.06], rtol=1e-12
    )


def test_the_lift_is_the_force_of_all_rotors_together() -> None:
    """Of axes that point to two sides, (3, 4) / 5 and (-3, 4) / 5, with 5 N each: 8 N; one of them reversed: 6 N."""
    robot = with_rotor(asymmetric_robot(), FORCE)
    axes = ((3.0, 0.0, 4.0), (-3.0, 0.0, 4.0))
    layout = tuple(replace(m, axis=axes[k % 2]) for k, m in enumerate(robot.mounts.layout))
    robot = replace(robot, mounts=replace(robot.mounts, layout=layout))
    states = np.array([[5.0, 5.0, 0.0, 0.0], [5.0, -5.0, 0.0, 0.0]])
    np.testing.assert_allclose(total_rotor_force(robot, states), [8.0, 6.0], rtol=1e-12)


def test_what_needs_one_rotor_type_says_so() -> None:
    with pytest.raises(ConfigError, match="identify hover needs one rotor type.*plain, reversible, force"):
        three_type_robot().the_rotor("identify hover")
    robot = three_type_robot()
    alike = replace(robot, rotors=dict.fromkeys(robot.rotors, PLAIN))
    assert alike.the_rotor("identify hover") == PLAIN
