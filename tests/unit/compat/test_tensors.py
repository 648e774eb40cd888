"""Tensor keys of the Aerial Gym Simulator, and tasks of this package with the interface of that simulator's."""

from collections.abc import Iterator
from dataclasses import replace

import gymnasium
import pytest
import torch

from aerial_gym import task_registry as TASKS  # noqa: N812
from aerial_gym.compat import EnvManager, SimBuilder, controller_registry, task_registry
from aerial_gym.compat.native_task import NativeTask, PositionSetpointTask, task_class
from aerial_gym.compat.tensors import KEYS
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.errors import CapabilityError, ConfigError, OwnershipError, UnknownNameError
from tests.refusals import assert_refused

E, A = 3, 40


def make_env(env_name: str, robot: str = "base_quadrotor", *, num_envs: int) -> EnvManager:
    names = ("base_sim", env_name, robot, "lee_velocity_control", "cpu")
    return SimBuilder().build_env(*names, num_envs=num_envs, seed=0)


@pytest.fixture(scope="module")
def env() -> Iterator[EnvManager]:
    env = make_env("dynamic_env", "base_quadrotor_with_camera_imu", num_envs=E)
    env.reset()
    env.step(torch.zeros(E, 4))
    env.render("sensors")
    return env


SHAPES = {  # parity.md 1.5, with N = E, one body per actor
    "vec_root_tensor": (E, 1 + A, 13), "unfolded_env_asset_state_tensor": (E * (1 + A), 13), "robot_state_tensor": (E, 13),
    "env_asset_state_tensor": (E, A, 13), "rigid_body_state_tensor": (E * (1 + A), 13), "robot_position": (E, 3),
    "robot_orientation": (E, 4), "robot_linvel": (E, 3), "robot_angvel": (E, 3), "robot_body_linvel": (E, 3),
    "robot_body_angvel": (E, 3), "robot_vehicle_orientation": (E, 4), "robot_vehicle_linvel": (E, 3),
    "robot_euler_angles": (E, 3), "obstacle_position": (E, A, 3), "obstacle_orientation": (E, A, 4),
    "obstacle_linvel": (E, A, 3), "obstacle_angvel": (E, A, 3), "env_bounds_min": (E, 3), "env_bounds_max": (E, 3),
    "gravity": (E, 3), "robot_mass": (E,), "robot_inertia": (E, 3, 3), "robot_actions": (E, 4), "robot_prev_actions": (E, 4),
    "env_actions": (E, A, 6), "prev_env_actions": (E, A, 6), "crashes": (E,), "truncations": (E,),
    "depth_range_pixels": (E, 1, 135, 240), "segmentation_pixels": (E, 1, 135, 240), "imu_measurement": (E, 6),
}  # fmt: skip
NUMBERS = {
    "dt": 0.01, "num_obstacles_in_env": A, "num_robot_actions": 4, "num_env_actions": 6, "dof_control_mode": "none",
}  # fmt: skip
ELSEWHERE = {"robot_contact_force_tensor", "curriculum_level", "rgb_pixels"}
ELSEWHERE |= {"dof_state_tensor", "unfolded_dof_state_tensor"}
"""Keys of other environments, tasks, cameras and robots."""


@pytest.mark.parametrize("name", KEYS)
def test_every_key_is_there_or_says_what_to_do(env: EnvManager, name: str) -> None:
    tensors = env.get_obs()
    if name in SHAPES:
        assert tuple(tensors[name].shape) == SHAPES[name]
        assert name in tensors
    elif name in NUMBERS:
        assert tensors[name] == pytest.approx(NUMBERS[name])
    elif name in ELSEWHERE:
        assert_refused(KeyError, "in this simulation", lambda: tensors[name])
    else:
        assert KEYS[name].remark
        assert_refused(KeyError, "has no counterpart here: ", lambda: tensors[name])
        assert tensors.get(name, "default") == "default"


def test_contact_and_colour_are_there_where_they_are_made() -> None:
    tensors = make_env("landing_env", num_envs=1).get_obs()
    assert tensors["robot_contact_force_tensor"].shape == (1, 3)


def test_keys_are_views_and_assignments_reach_the_simulation(env: EnvManager) -> None:
    tensors, crashes = env.get_obs(), env.env.gtd["crashes"]
    assert tensors["crashes"] is crashes
    tensors["crashes"] = torch.tensor([True, False, True])
    assert env.env.gtd["crashes"] is crashes
    assert crashes.tolist() == [True, False, True]
    tensors["crashes"] = torch.zeros(E, dtype=torch.bool)
    with pytest.raises(RuntimeError):
        tensors["crashes"] = torch.zeros(E + 2, dtype=torch.bool)
    with pytest.raises(OwnershipError, match="'gravity' = sim_cfg.gravity here: it follows from other keys"):
        tensors["gravity"] = torch.zeros(3)


def test_scripts_keep_things_of_their_own_and_an_unknown_key_names_the_nearest(env: EnvManager) -> None:
    tensors = env.get_obs()
    tensors["curriculum_level"] = 7
    assert tensors["curriculum_level"] == 7
    assert "curriculum_level" in list(tensors)
    del tensors["curriculum_level"]
    assert "curriculum_level" not in tensors
    with pytest.raises(OwnershipError, match="only keys that the script has added"):
        del tensors["robot_position"]
    assert_refused(UnknownNameError, "no tensor key 'robot_positon' .* mean", lambda: env.get_obs()["robot_positon"])


def test_number_of_obstacles_counts_those_that_are_kept() -> None:
    """15 rows in use: the 9 that are always kept and 6 others; the rest is parked at the next reset."""
    env = make_env("env_with_obstacles", num_envs=2)
    assert env.global_tensor_dict["num_obstacles_in_env"] == 44
    env.global_tensor_dict["num_obstacles_in_env"] = 15
    env.env.reset()
    present = env.global_tensor_dict["obstacle_position"][..., 2] > -500.0
    assert (present.sum(dim=1) <= 15).all()  # clearance around the start may park some more
    assert (present.sum(dim=1) > 9).all()
    assert env.asset_manager.num_keep_in_env == 9


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
    assert_refused(ConfigError, words, task_class(NAME), Wide, device="cpu", num_envs=2)
    task = make()
    assert_refused(CapabilityError, r"position_setpoint_task.reset_idx\(\[0\]\): step\(\) resets", task.reset_idx, [0])
    task.render()
    task.close()


def test_numbers_of_rewards_are_those_of_the_terms() -> None:
    names = task_registry.get_task_config(NAME).reward_parameters
    assert (names["near.height"], names["upright.offset"]) == (3.0, 0.1)
    assert (names["near.weight"], names["crash"]) == (1.0, -20.0)

    class Keen(task_registry.get_task_config(NAME)):
        reward_parameters = {"near.height": 30.0, "far.weight": 0.5, "crash": -7.0}

    keen = task_class(NAME)(Keen, num_envs=2, device="cpu").task.cfg
    assert (keen.rewards["near"].params, keen.rewards["far"].weight) == ({"height": 30.0, "width": 8.0}, 0.5)
    assert keen.crash_reward.value == -7.0

    for key, words in (
        ("naer.height", "naer: what this class stands for has none of that name. Known: near, far"),
        ("near.hight", r"reward 'near' \(distance_bell\): no parameter 'hight'. Did you mean 'height'"),
    ):
        wrong = type("Wrong", (task_registry.get_task_config(NAME),), {"reward_parameters": {key: 30.0}})
        assert_refused(ConfigError, words, task_class(NAME), wrong, num_envs=2, device="cpu")
