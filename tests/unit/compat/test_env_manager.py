"""The environment manager: ids, flags that outlive a reset, states that are written, names that are gone."""

import random

import numpy as np
import pytest
import torch

from aerial_gym.compat import BaseTask, EnvManager, SimBuilder
from aerial_gym.compat.registries import env_config_registry
from aerial_gym.errors import ConfigError, ShapeError
from tests.refusals import assert_refused


def build(env_name: str = "empty_env", **more: object) -> EnvManager:
    names = ("base_sim", env_name, "base_quadrotor", "lee_velocity_control", "cpu")
    env = SimBuilder().build_env(*names, num_envs=4, **more)
    env.reset()
    for _ in range(3):
        env.step(actions=torch.full((4, 4), 0.5))
    return env


@pytest.mark.parametrize("env_ids", [[1, 3], torch.tensor([1, 3]), torch.tensor([False, True, False, True])])
def test_reset_idx_leaves_other_rows_alone(env_ids: object) -> None:
    env = build()
    before = env.global_tensor_dict["robot_state_tensor"].clone()
    env.reset_idx(env_ids)
    after = env.global_tensor_dict["robot_state_tensor"]
    assert torch.equal(before[[0, 2]], after[[0, 2]])
    assert not (before == after)[[1, 3]].all(dim=1).any()
    assert env.sim_steps.tolist() == [3, 0, 3, 0]
    assert_refused(ShapeError, r"env_ids is a mask of shape \(2,\)", env.reset_idx, torch.tensor([True, False]))


def test_flags_outlive_the_reset_until_the_next_step() -> None:
    env = build()
    tensors = env.get_obs()
    tensors["crashes"][:] = torch.tensor([True, False, False, False])
    tensors["truncations"][:] = torch.tensor([False, False, True, False])
    assert env.post_reward_calculation_step().tolist() == [0, 2]
    assert tensors["crashes"].tolist() == [True, False, False, False]
    assert tensors["truncations"].tolist() == [False, False, True, False]
    assert env.sim_steps.tolist() == [0, 3, 0, 3]
    env.step(torch.zeros(4, 4))
    assert not (tensors["crashes"] | tensors["truncations"]).any()


def test_reset_on_collision_keeps_crashed_rows() -> None:
    class NoResetEnv(env_config_registry.get_env_config("empty_env")):
        class env(env_config_registry.get_env_config("empty_env").env):
            reset_on_collision = False

    env_config_registry.register("lasting", NoResetEnv)
    env = build("lasting")
    env.get_obs()["crashes"][:] = True
    env.get_obs()["truncations"][1] = True
    assert env.reset_terminated_and_truncated_envs().tolist() == [1]


def test_a_written_state_reaches_the_physics_in_its_row_alone() -> None:
    env = build()
    tensors = env.get_obs()
    keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
    before = {key: tensors[key].clone() for key in keys}
    half = 0.5**0.5
    row = [1.0, 2.0, 3.0, 0.0, 0.0, half, half, 0.1, 0.2, 0.3, 1.0, 0.0, 0.0]
    tensors["robot_state_tensor"][2] = torch.tensor(row)
    env.IGE_env.write_to_sim()
    for key in keys:
        assert torch.equal(tensors[key][[0, 1, 3]], before[key][[0, 1, 3]]), key
    assert tensors["robot_position"][2].tolist() == [1.0, 2.0, 3.0]
    torch.testing.assert_close(tensors["robot_body_angvel"][2], torch.tensor([0.0, -1.0, 0.0]), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(tensors["robot_state_tensor"][2], torch.tensor(row), atol=1e-6, rtol=0.0)
    assert tensors["robot_euler_angles"][2, 2] == pytest.approx(torch.pi / 2, abs=1e-5)


def test_the_seed_is_that_of_torch_unless_given() -> None:
    def start(*, seed: int | None = None) -> torch.Tensor:
        return build(seed=seed).get_obs()["robot_position"]

    torch.manual_seed(5)
    first = start()
    torch.manual_seed(5)
    assert torch.equal(first, start())
    assert torch.equal(first, start(seed=5))
    assert not torch.equal(first, start(seed=6))


def test_the_number_of_environments_is_the_class_s_unless_given() -> None:
    env = SimBuilder().build_env("base_sim", "empty_env", "base_quadrotor", "lee_velocity_control", "cpu")
    assert env.num_envs == env.cfg.env.num_envs == 64
    assert (build().cfg.env.num_envs, env_config_registry.get_env_config("empty_env").env.num_envs) == (4, 64)


def test_what_is_gone_says_what_to_do() -> None:
    env = build()
    assert_refused(ConfigError, "render_components = 'sensor': must be one", env.render, render_components="sensor")
    env.render(render_components="viewer")
    with pytest.raises(AttributeError, match="env_manager.warp_env: the simulation itself is env_manager.env"):
        env.warp_env  # noqa: B018
    with pytest.raises(AttributeError, match="IGE_env.gym: there is no Isaac Gym here"):
        env.IGE_env.gym  # noqa: B018
    robot = env.robot_manager.robot
    assert robot.controller_config.num_actions == 4
    assert not robot.cfg.sensor_config.enable_camera
    env.robot_manager.reset_idx([0])
    env.delete_env()


class TaskConfig:
    def __init__(self, seed: int | None) -> None:
        self.seed = seed


def test_a_seed_reaches_what_scripts_use() -> None:
    def draws(seed: int) -> tuple[float, float, float]:
        BaseTask(TaskConfig(seed))
        return random.random(), float(np.random.rand()), torch.rand(1).item()

    assert draws(3) == draws(3)
    assert draws(3) != draws(4)


@pytest.mark.parametrize("seed", [None, -1])
def test_no_seed_leaves_them_alone(seed: int | None) -> None:
    torch.manual_seed(9)
    BaseTask(TaskConfig(seed))
    first = torch.rand(1)
    torch.manual_seed(9)
    assert torch.equal(first, torch.rand(1))


@pytest.mark.parametrize("method", ["reset", "step", "reset_idx", "render"])
def test_what_a_task_must_define_is_named(method: str) -> None:
    task = BaseTask(TaskConfig(None))
    with pytest.raises(NotImplementedError, match=f"BaseTask.{method}: the task class must define it"):
        getattr(task, method)(*([] if method in ("reset", "render") else [0]))
    task.close()
