"""What tells efforts of joints from flights knows the water on links, or refuses it."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.sim2real.teststand.joints.courses import _efforts
from aerial_gym.sim2real.teststand.joints.swing import body_motion
from tests.physics.articulated.test_link_buoyancy import draw_state, make_joints, tree_state, under_water
from tests.physics.articulated.test_link_drag import fly, make_model

IN_WATER = {
    "link_buoyancy": {"force": 1.0, "left.x": 0.02},
    "link_added_mass": {"mx": 0.1, "my": 0.4, "right.jz": 1e-3},
    "link_drag": {"qx": 0.1, "lz": 0.2},
}


def test_free_joints_under_water_gave_no_effort() -> None:
    """By inverse dynamics of a motion that the step says; 3 m/s² and more times 0.1 kg are at stake."""
    robot = under_water(make_joints(), IN_WATER)
    model, state = make_model(robot, gravity=STANDARD_GRAVITY, num_envs=4)
    state, dt = draw_state(state), 1e-7
    after = fly(model, state, dt, 1)
    lin_acc = quat_rotate_inverse(state.attitude, (after.lin_vel - state.lin_vel) / dt)
    acc = torch.cat((lin_acc, (after.ang_vel - state.ang_vel) / dt, (after.joint_vel - state.joint_vel) / dt), dim=-1)
    efforts = _efforts(robot, tree_state(state), state.rotor_speed, acc)
    torch.testing.assert_close(efforts, torch.zeros_like(efforts), rtol=0.0, atol=1e-5)


def test_joints_that_nobody_logged_are_not_told_under_water() -> None:
    robot = replace(under_water(make_joints(), IN_WATER), effects_source="test")
    with pytest.raises(ConfigError, match="identify joints: link_added_mass cannot be simulated without .* Log them"):
        body_motion(robot, None, bandwidth=15.0)
