"""Tasks of this package with the interface of that simulator's."""

from dataclasses import replace

import gymnasium
import pytest
import torch

from aerial_gym import task_registry as TASKS  # noqa: N812
from aerial_gym.compat import controller_registry, task_registry
from aerial_gym.compat.native_task import NativeTask, PositionSetpointTask, task_class
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.errors import CapabilityError, ConfigError

NAME = "position_setpoint_task"


def make(**given: object) -> NativeTask:
    return task_registry.make_task(NAME, num_envs=3, device="cpu", **given)


def test_it_is_our_task() -> None:
    reference, actual = make(seed=4), TASKS.make_task(NAME, num_envs=3, device="cpu", seed=4)
    assert isinstance(reference, PositionSetpointTask)
    obs, rewards, terminations, truncations, infos = reference.reset()
    assert torch.equal(obs["observations"], actual.reset()[0]["observations"])
    assert rewards.tolist() == [0.0] * 3
    assert not (terminations | truncations).any()
    assert infos == {}
    action = torch.full((3, 4), 0.1)
    for _ in range(5):
        got, want = reference.step(action), actual.step(action)
    obs, rewards, terminations, truncations, infos = got
    assert torch.equal(obs["observations"], want[0]["observations"])
    assert torch.equal(rewards, want[1])
    assert set(obs) == {"observations", "priviliged_obs", "collisions", "rewards", "terminations", "truncations"}
    assert obs["priviliged_obs"].shape == (3, 0)
    assert {"final_observation", "time_outs"} <= set(infos)
    assert reference.observation_space == actual.observation_space
    assert (reference.task_config.num_envs, reference.task_config.action_space_dim) == (3, 4)
    assert task_registry.get_task_config(NAME).num_envs == 4096


def test_a_configuration_class_changes_it() -> None:
    class Short(task_registry.get_task_config(NAME)):
        episode_len_steps = 3
        return_state_before_reset = True

    task_registry.register_task("short_task", task_class(NAME), Short)
    task = task_registry.make_task("short_task", num_envs=2, device="cpu", seed=0)
    task.reset()
    flags = []
    for _ in range(3):
        obs, _, _, truncations, infos = task.step(torch.zeros(2, 4))
        flags.append(truncations.tolist())
    assert flags == [[False, False], [False, False], [True, True]]
    assert torch.equal(obs["observations"], infos["final_observation"])
    assert task.sim_env.sim_steps.tolist() == [0, 0]


def test_it_draws_what_the_task_says(monkeypatch: pytest.MonkeyPatch) -> None:
    class RandomRobot(controller_registry.get_controller_config("lee_velocity_control")):
        randomize_params = True

    drawn = {"body.mass": RandomizeCfg(low=0.8, high=1.2)}
    cfg = replace(TASKS.get(NAME), randomize=drawn)
    monkeypatch.setitem(TASKS._entries, "drawn_task", cfg)
    reference = task_registry.make_task("drawn_task", num_envs=3, device="cpu", seed=4)
    actual = TASKS.make_task("drawn_task", num_envs=3, device="cpu", seed=4)
    reference.reset(), actual.reset()
    assert torch.equal(reference.sim_env.env.draws()["body.mass"], actual.env.draws()["body.mass"])
    assert reference.sim_env.env.gtd["robot_mass"].std() > 0.0
    law = controller_registry.get_controller_class(cfg.controller)
    controller_registry.register_controller("drawn_gains", law, RandomRobot)

    class Both(task_registry.get_task_config("drawn_task")):
        controller_name = "drawn_gains"

    both = task_class("drawn_task")(Both, num_envs=3, device="cpu", seed=4)
    both.reset()
    assert {"body.mass", "gains.velocity"} <= both.sim_env.env.draws().keys()


def test_a_reward_that_would_not_be_called_is_refused() -> None:
    words = "class CustomTask: compute_rewards_and_crashes would not be called: .*setpoint_task"
    with pytest.raises(ConfigError, match=words):

        class CustomTask(PositionSetpointTask):
            def compute_rewards_and_crashes(self) -> None: ...


def test_wrappers_of_scripts_take_it() -> None:
    class ExtractObs(gymnasium.Wrapper):
        def reset(self, **kwargs: object) -> torch.Tensor:
            obs, *_ = super().reset(**kwargs)
            return obs["observations"]

        def step(self, action: torch.Tensor) -> tuple[torch.Tensor, ...]:
            obs, rewards, terminated, truncated, _ = super().step(action)
            return obs["observations"], rewards, terminated | truncated

    env = ExtractObs(make(seed=0))
    assert env.reset().shape == (3, 13)
    assert [part.shape for part in env.step(torch.zeros(3, 4))] == [(3, 13), (3,), (3,)]
    assert env.get_wrapper_attr("task_config").action_space_dim == 4


def test_what_it_cannot_says_what_to_do() -> None:
    class Wide(task_registry.get_task_config(NAME)):
        observation_space_dim = 14

    words = r"Wide.observation_space_dim = 14: follows from `observations:` of a task file"
    with pytest.raises(ConfigError, match=words):
        task_class(NAME)(Wide, device="cpu", num_envs=2)
    task = make()
    with pytest.raises(CapabilityError, match=r"position_setpoint_task.reset_idx\(\[0\]\): step\(\) resets"):
        task.reset_idx([0])
    task.render()
    task.close()


def test_numbers_of_rewards_are_those_of_the_terms() -> None:
    names = task_registry.get_task_config(NAME).reward_parameters
    assert (names["near.height"], names["upright.offset"]) == (3.0, 0.1)
    assert (names["near.weight"], names["crash"]) == (1.0, -20.0)

    class Keen(task_registry.get_task_config(NAME)):
        reward_parameters = {"near.height": 30.0, "far.weight": 0.5, "crash": -7.0}

    keen = task_class(NAME)(Keen, num_envs=2, device="cpu").task.cfg
    assert keen.rewards["near"].params == {"height": 30.0, "width": 8.0}
    assert keen.rewards["far"].weight == 0.5
    assert keen.crash_reward.value == -7.0

    for key, words in (
        ("naer.height", "naer: what this class stands for has none of that name. Known: near, far"),
        ("near.hight", r"reward 'near' \(distance_bell\): no parameter 'hight'. Did you mean 'height'"),
    ):
        wrong = type("Wrong", (task_registry.get_task_config(NAME),), {"reward_parameters": {key: 30.0}})
        with pytest.raises(ConfigError, match=words):
            task_class(NAME)(wrong, num_envs=2, device="cpu")
