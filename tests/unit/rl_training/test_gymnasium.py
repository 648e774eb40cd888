"""Tasks as environments of Gymnasium: what comes back where episodes end, ids, wrappers and pictures."""

import json
import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import wrappers
from gymnasium.envs.registration import load_env_creator
from gymnasium.utils.env_checker import check_env

from aerial_gym.errors import ConfigError, MissingDependencyError, ShapeError
from aerial_gym.rl_training import GymnasiumEnv, GymnasiumVectorEnv
from aerial_gym.rl_training.gymnasium import FINAL
from aerial_gym.task import Task, task_registry
from tests.refusals import assert_refused

OLD = FINAL == "final_observation"  # Gymnasium 0.29
ID = "aerial_gym/PositionSetpoint-v0"
AWAY = np.array([0.0, 0.8, 0.0, 0.0], dtype=np.float32)  # Rolls: the robot flies off sideways


def make(num_envs: int = 3, **options: object) -> GymnasiumVectorEnv:
    task = task_registry.make_task("position_setpoint_task", num_envs=num_envs, device="cpu", seed=4)
    return GymnasiumVectorEnv(task, **{"autoreset_mode": "same_step"} | options)


def make_vec(num_envs: int, **options: object) -> GymnasiumVectorEnv:
    """Make environments by their id, as each version of Gymnasium wants it."""
    given = {"vectorization_mode": "custom", "vector_kwargs": options} if OLD else options
    return gymnasium.make_vec(ID, num_envs=num_envs, **given)


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
    steps, told = env.task.cfg.episode_len_steps, info["final_info"]
    if OLD:  # an array of dictionaries in Gymnasium 0.29, a dictionary of arrays in Gymnasium 1
        assert told[0] is None
        assert (told[1]["episode"]["l"], told[1]["is_success"]) == (steps, False)
    else:
        assert (told["episode"]["l"].tolist(), told["_episode"].tolist()) == ([0, steps, 0], [False, True, False])
        assert told["_is_success"].tolist() == [False, True, False]


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
    told = r"output = 'jax': must be numpy or torch; .*autoreset_mode = 'disabled': must be same_step or next_step"
    assert_refused(ConfigError, told, GymnasiumVectorEnv, env.task, output="jax", autoreset_mode="disabled")
    assert_refused(ShapeError, r"actions has shape \(4,\), expected \(E, U\) = \(3, 4\)", env.step, np.zeros(4))


def test_next_step_returns_the_last_observation_and_then_the_first() -> None:
    """Row 1 is truncated in the first step; the second one ignores its action and starts the next episode."""
    now, late = make(), make(autoreset_mode="next_step")
    for env in (now, late):
        env.reset(seed=7)
        set_age(env, [0, last_step(env.task), 0])
    action = np.full((3, 4), 0.1, dtype=np.float32)
    first, _, _, _, info = now.step(action)
    observation, reward, terminated, truncated, told = late.step(action)
    np.testing.assert_array_equal(observation[1], info[FINAL][1])
    assert (truncated.tolist(), terminated.any(), FINAL in told) == ([False, True, False], False, False)
    assert (told["is_success"].tolist(), told["_is_success"].tolist()) == ([False] * 3, [False, True, False])
    observation, reward, terminated, truncated, told = late.step(action)
    np.testing.assert_array_equal(observation[1], first[1])
    assert (reward[1], terminated.any(), truncated.any()) == (0.0, False, False)
    assert "is_success" not in told


def test_ids_make_one_environment_or_many() -> None:
    env = make_vec(2, seed=3, autoreset_mode="next_step")
    alone = gymnasium.make(ID, seed=3)
    many, _ = env.reset()
    one, info = alone.reset()
    np.testing.assert_array_equal(one, many[0])
    assert info == {}
    action = np.full(4, 0.1, dtype=np.float32)
    observation, reward, terminated, truncated, info = alone.step(action)
    expected = env.step(np.stack((action, action)))
    np.testing.assert_array_equal(observation, expected[0][0])
    assert (reward, terminated, truncated, info) == (float(expected[1][0]), False, False, {"time_outs": False})
    assert isinstance(alone.unwrapped, GymnasiumEnv)
    assert json.loads(alone.spec.to_json())["id"] == ID
    assert gymnasium.make(ID).reset()[0].tolist() != gymnasium.make(ID).reset()[0].tolist()  # seeds are drawn
    if not OLD:
        assert make_vec(1).metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    alone.close()
    env.close()


def test_an_episode_of_one_environment_stays_at_its_end_until_its_reset() -> None:
    env, batch = gymnasium.make(ID, seed=3).unwrapped, make_vec(1, seed=3, autoreset_mode="same_step")
    action, last = np.full(4, 0.1, dtype=np.float32), last_step(env.task)
    for each in (env, batch):
        each.reset()
        each.task.env.gtd["sim_steps"][:] = last
    observation, _, terminated, truncated, info = env.step(action)
    started, *_, told = batch.step(action[None])
    np.testing.assert_array_equal(observation, told[FINAL][0])
    assert (terminated, truncated, info) == (False, True, {"time_outs": True, "is_success": False})
    np.testing.assert_array_equal(env.reset()[0], started[0])  # the next episode is that of the batch


def test_gymnasium_checks_the_environment() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*infinity. This is probably too")  # a position has no bounds
        env = gymnasium.make(ID)
        check_env(env.unwrapped)
        env.close()


def fly(env: Any, steps: int = 4) -> Any:
    """Fly random actions; in the first environment an episode ends."""
    env.reset(seed=1)
    task = env.unwrapped.task
    task.env.gtd["sim_steps"][0] = task.cfg.episode_len_steps - 2
    for _ in range(steps):
        result = env.step(env.action_space.sample())
    return result


SINGLE = ("RecordEpisodeStatistics", "ClipAction", "NormalizeObservation", "NormalizeReward", "FlattenObservation")


def test_wrappers_of_gymnasium_take_one_environment() -> None:
    env = gymnasium.make(ID)
    for name in SINGLE:
        env = getattr(wrappers, name)(env)
    assert np.isfinite(fly(env, 2)[0]).all()
    assert env.step(env.action_space.sample())[3] is False
    limited = wrappers.TimeLimit(gymnasium.make(ID), 3)
    assert fly(limited, 2)[3] is True


VECTOR = ("RecordEpisodeStatistics", "ClipAction", "NormalizeReward", "NormalizeObservation", "DictInfoToList")


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_wrappers_of_gymnasium_take_many_environments(mode: str) -> None:
    """Of Gymnasium 1, those of observations take only ``next_step``."""
    if OLD:
        library, names = wrappers, (*VECTOR[:-1], "VectorListInfo")
    else:
        import gymnasium.wrappers.vector as library

        names = tuple(name for name in VECTOR if mode == "next_step" or "Observation" not in name)
    env = make(autoreset_mode=mode)
    for name in names:
        env = getattr(library, name)(env)
    assert len(fly(env)[0]) == 3
    counted = library.RecordEpisodeStatistics(make(autoreset_mode=mode))
    infos = fly(counted, 2)[4]
    assert [bool(ended) for ended in infos["_episode"]] == [True, False, False]


def test_pictures_are_those_of_the_chase_camera() -> None:
    env = gymnasium.make(ID, render_mode="rgb_array", seed=1)
    env.reset()
    before = env.render()
    for _ in range(20):
        env.step(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32))
    picture = env.render()
    assert (picture.shape, picture.dtype) == ((270, 480, 3), np.uint8)
    assert np.abs(picture.astype(int) - before).max() > 50
    red = (picture[..., 0] > 120) & (picture[..., 1] < 80)
    assert red.sum() > 400  # the front rotors
    frames = gymnasium.make(ID, render_mode="rgb_array_list")
    fly(frames, 2)
    assert len(frames.render()) == 3
    env = make(2, render_mode="rgb_array")
    env.reset()
    first, second = env.render()
    assert first.shape == picture.shape
    assert not np.array_equal(first, second)
    assert make().render() is None


def test_pictures_need_pillow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aerial_gym.task.chase_view.find_spec", lambda name: None)
    assert_refused(MissingDependencyError, "need Pillow: pip install pillow", make, render_mode="rgb_array")


def test_an_image_stands_beside_the_observations() -> None:
    task = task_registry.make_task("pixel_navigation_task", num_envs=2, device="cpu", seed=0)
    env = GymnasiumVectorEnv(task, autoreset_mode="same_step")
    observation, _ = env.reset()
    assert env.observation_space.contains(observation)
    assert observation.keys() == env.single_observation_space.spaces.keys() > {"observations"}
    set_age(env, [0, last_step(task)])
    observation, *_, info = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    assert env.observation_space.contains(observation)
    assert env.single_observation_space.contains(info[FINAL][1])


def test_the_task_sets_the_length_of_episodes_and_the_number_of_environments() -> None:
    creator = load_env_creator(gymnasium.spec(ID).vector_entry_point)
    assert_refused(ConfigError, "max_episode_steps = 9: the task says", creator, num_envs=1, max_episode_steps=9)
    assert_refused(ConfigError, "GymnasiumEnv: num_envs = 3: must be 1", GymnasiumEnv, make().task)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["sync", "async"])
def test_gymnasium_runs_one_environment_per_row_or_process(mode: str) -> None:
    """A fork of a process with threads of OpenMP would wait for ever."""
    code = f"""
import gymnasium, aerial_gym
if __name__ == "__main__":
    env = gymnasium.make_vec("{ID}", num_envs=2, vectorization_mode="{mode}")
    env.reset(seed=1)
    print(env.step(env.action_space.sample())[0].shape)
    env.close()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=300)
    assert done.stdout.endswith("(2, 13)\n"), done.stderr
