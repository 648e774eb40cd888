"""Robots with a body of their own: a URDF, an allocation matrix."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aerial_gym.compat import SimBuilder, robot_registry
from aerial_gym.compat.config import robots
from aerial_gym.compat.config.fields import values_equal
from aerial_gym.compat.config.robots import allocation_matrix
from aerial_gym.compat.registries import BaseMultirotor
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from tests.refusals import assert_refused

pytest.importorskip("yourdfpy")

URDF = """<robot name="hexa"><link name="base">
<inertial><mass value="1.2"/><inertia ixx="0.012" iyy="0.013" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.3 0.4 0.12"/></geometry></collision>
<collision><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.01" length="0.1"/></geometry></collision>
<collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.03"/></geometry></collision></link></robot>"""


def hexarotor(folder: Path, **changes: Any) -> type:
    angles = np.arange(6) * np.pi / 3
    x, y, spins = 0.25 * np.cos(angles), 0.25 * np.sin(angles), [1, -1] * 3
    matrix = np.stack([0 * x, 0 * x, 1 + 0 * x, y, -x, [-0.02 * s for s in spins]])
    (folder / "hexa.urdf").write_text(URDF)

    class HexaCfg:
        class robot_asset:
            asset_folder = str(folder)
            file = "hexa.urdf"

        class control_allocator_config:
            num_motors = 6
            force_application_level = "root_link"
            motor_directions = spins
            allocation_matrix = matrix

            class motor_model_config:
                use_rps = True
                motor_thrust_constant_min = motor_thrust_constant_max = 2.0e-5
                motor_time_constant_increasing_min = motor_time_constant_increasing_max = 0.03
                motor_time_constant_decreasing_min = motor_time_constant_decreasing_max = 0.03
                min_thrust, max_thrust = 0.0, 6.0
                thrust_to_torque_ratio = 0.02

    for name, value in changes.items():
        owner = HexaCfg.robot_asset if name in ("asset_folder", "file") else HexaCfg.control_allocator_config
        setattr(owner, name, value)
    return HexaCfg


def test_a_robot_of_one_s_own_flies(tmp_path: Path) -> None:
    cls = hexarotor(tmp_path)
    cfg = robots.translate_robot(cls)
    assert cfg.body.mass == pytest.approx(1.2)
    np.testing.assert_allclose(cfg.body.inertia, np.diag([0.012, 0.013, 0.02]))
    assert values_equal(allocation_matrix(cfg), cls.control_allocator_config.allocation_matrix)
    assert [box.size for box in cfg.collision.boxes] == [(0.3, 0.4, 0.12), (0.02, 0.02, 0.1)]
    assert cfg.collision.boxes[1].center == (0.0, 0.0, 0.1)
    assert [(ball.center, ball.radius) for ball in cfg.collision.spheres] == [((0.2, 0.0, 0.0), 0.03)]
    robot_registry.register("hexa", BaseMultirotor, cls)
    env = SimBuilder().build_env("base_sim", "empty_env", "hexa", "lee_position_control", "cpu", num_envs=2, seed=0)
    env.reset()
    goal = torch.tensor([[0.1, -0.2, 0.3, 0.5]]).repeat(2, 1)
    for _ in range(600):
        env.step(actions=goal)
    tensors = env.get_obs()
    torch.testing.assert_close(tensors["robot_position"], goal[:, :3], atol=0.02, rtol=0.0)
    torch.testing.assert_close(tensors["robot_euler_angles"][:, 2], goal[:, 3], atol=0.02, rtol=0.0)


def test_allocation_matrix_of_the_quadrotor_is_that_of_the_class() -> None:
    """Parity 2.4: Mx (-l,-l,l,l), My (-l,l,l,-l), Mz (-c,c,-c,c) with l = 0.13 m, c = 0.01 m."""
    expected = [
        [0.0] * 4, [0.0] * 4, [1.0] * 4,
        [-0.13, -0.13, 0.13, 0.13], [-0.13, 0.13, 0.13, -0.13], [-0.01, 0.01, -0.01, 0.01],
    ]  # fmt: skip
    assert values_equal(allocation_matrix(ROBOTS.get("base_quadrotor")), expected)


@pytest.mark.parametrize(("changes", "message"), [
    ({"file": "none.urdf"}, "robot_asset .*none.urdf: no such URDF file. Those of that .* quad/quad.urdf, .* Give one"),
    ({"num_motors": 5}, r"of shape \(6, 6\): needs a column for each of the 5 motors"),
    ({"motor_directions": [1] * 6}, "motor 1: torque 0.02 about its axis per thrust, but .* say -0.02. There"),
    ({"allocation_matrix": np.zeros((6, 6))}, "motor 0: force .* has the size 0, not 1"),
])  # fmt: skip
def test_what_contradicts_itself_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    assert_refused(ConfigError, message, robots.translate_robot, hexarotor(tmp_path, **changes))


def test_a_robot_without_gravity_floats() -> None:
    class WeightlessRobot(robots.BaseQuadCfg):
        class robot_asset(robots.BaseQuadCfg.robot_asset):
            disable_gravity = True

    robot_registry.register("floating", BaseMultirotor, WeightlessRobot)
    env = SimBuilder().build_env("base_sim", "empty_env", "floating", "no_control", "cpu", num_envs=3, seed=1)
    env.reset()
    env.step(torch.zeros(3, 4))  # from hover speed at weight 0: the rotors stand
    before = env.get_obs()["robot_linvel"].clone()
    for _ in range(5):
        env.step(torch.zeros(3, 4))
    torch.testing.assert_close(env.get_obs()["robot_linvel"], before, atol=1e-6, rtol=0.0)
