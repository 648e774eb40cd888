"""A task as a ``gymnasium.vector.VectorEnv``: what comes back where episodes end, in NumPy and in torch."""

import gymnasium
import numpy as np
import pytest
import torch

from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.rl_training import GymnasiumVectorEnv
from aerial_gym.rl_training.gymnasium import FINAL
from aerial_gym.task import Task, task_registry
from tests.refusals import assert_refused

AWAY = np.array([0.0, 0.8, 0.0, 0.0], dtype=np.float32)  # Rolls: the robot flies off sideways


def make(num_envs: int = 3, *, output: str = "numpy") -> GymnasiumVectorEnv:
    task = task_registry.make_task("position_setpoint_task", num_envs=num_envs, device="cpu", seed=4)
    return GymnasiumVectorEnv(task, output=output)


def set_age(env: GymnasiumVectorEnv, age: list[int]) -> None:
    env.task.env.gtd["sim_steps"][:] = torch.tensor(age, dtype=torch.int32)


def last_step(task: Task) -> int:
    return task.cfg.episode_len_steps - 1


def test_it_is_a_vector_environment_with_batched_and_single_spaces() -> None:
    env = make()
    assert isinstance(env, gymnasium.vector.VectorEnv)
    assert (env.num_envs, env.single_observation_space.shape, env.single_action_space.shape) == (3, (13,), (4,))
    assert (env.observation_space.shape, env.action_space.shape) == ((3, 13), (3, 4))
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert info == {}
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert FINAL not in info
    assert env.observation_space.contains(observation)
    for value, dtype in ((reward, np.float32), (terminated, np.bool_), (truncated, np.bool_)):
        assert isinstance(value, np.ndarray)
        assert (value.shape, value.dtype) == ((3,), dtype)


def test_only_rows_that_end_have_a_final_observation_and_info() -> None:
    """Row 1 is at its last step: it is truncated, the others are not."""
    env = make()
    env.reset()
    before = env.step(np.zeros((3, 4)))[0]
    set_age(env, [5, last_step(env.task), 5])
    observation, _, terminated, truncated, info = env.step(np.zeros((3, 4)))
    assert not terminated.any()
    assert (truncated.tolist(), info["time_outs"].tolist()) == ([False, True, False], [False, True, False])
    assert info[f"_{FINAL}"].tolist() == info["_final_info"].tolist() == [False, True, False]
    assert info[FINAL][0] is None
    assert info[FINAL][2] is None
    np.testing.assert_allclose(info[FINAL][1][:3], before[1, :3], atol=0.05)  # 10 ms on from the old episode
    assert np.abs(observation[1, :3] - info[FINAL][1][:3]).max() > 1e-3  # the new episode starts elsewhere
    assert info["final_info"][1]["episode"]["l"] == env.task.cfg.episode_len_steps
    assert info["final_info"][0] is None


def test_a_crash_is_terminated_and_no_time_out_even_at_the_last_step() -> None:
    """Row 0 is beyond the largest distance when its time is up: it is a crash, whose value must not be bootstrapped."""
    env = make()
    env.reset()
    set_age(env, [last_step(env.task), 0, 0])
    env.task.env.gtd["robot_position"][0] = torch.tensor([9.0, 0.0, 0.0])
    _, reward, terminated, truncated, info = env.step(np.tile(AWAY, (3, 1)))
    assert terminated.tolist() == [True, False, False]
    assert not truncated.any()
    assert not info["time_outs"].any()
    assert (reward[0], info[FINAL][0][0]) == (-20.0, pytest.approx(-9.0, abs=0.05))


def test_torch_and_numpy_say_the_same() -> None:
    one, other = make(), make(output="torch")
    for env in (one, other):
        env.reset(seed=7)
        set_age(env, [0, 0, last_step(env.task)])
    numbers, tensors = one.step(np.full((3, 4), 0.1)), other.step(torch.full((3, 4), 0.1))
    for number, tensor in zip(numbers[:4], tensors[:4], strict=True):
        np.testing.assert_array_equal(number, tensor.numpy())
    np.testing.assert_array_equal(numbers[4][FINAL][2], tensors[4][FINAL][2].numpy())
    np.testing.assert_array_equal(numbers[4][f"_{FINAL}"], tensors[4][f"_{FINAL}"].numpy())


def test_a_seed_given_to_reset_decides_the_starts() -> None:
    env = make()
    first, second, third = env.reset(seed=5)[0], env.reset()[0], env.reset(seed=5)[0]
    np.testing.assert_array_equal(first, third)
    assert not np.array_equal(first, second)


def test_wrong_requests_are_refused() -> None:
    env = make()
    assert_refused(ConfigError, "GymnasiumVectorEnv.output = 'jax':", GymnasiumVectorEnv, env.task, output="jax")
    assert_refused(ShapeError, r"actions has shape \(4,\), expected \(E, U\) = \(3, 4\)", env.step, np.zeros(4))
