"""An environment is the same alone, among 4 and among 37, bit for bit: nothing that is drawn or flown looks at a neighbour."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import EnvManager, Task, task_registry
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.repetitions import frequent_values

FEW, MANY = 4, 37
"""Neither is a multiple of the width of the processor's vectors."""

OBSTACLE_COURSES = ("env_with_obstacles", "dynamic_env", "forest_env", "env_with_lidar_nav_obstacles", "landing_env")


RANDOMIZE = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "rotor.thrust_map": RandomizeCfg(each_rotor=True, distribution="normal", mean=1.0, std=0.05, low=0.8, high=1.2),
    "effects.gusts.std": RandomizeCfg(how="value", low=0.5, high=2.0),
    "effects.rotor_drag.dx": RandomizeCfg(how="value", low=0.1, high=0.2),
    "gains.velocity": RandomizeCfg(low=0.9, high=1.1),
    "effects.imu_bias.ax": RandomizeCfg(how="value", low=-0.1, high=0.1),
    "effects.imu_misalignment.yaw": RandomizeCfg(how="value", low=-0.1, high=0.1),
    "sensors.base_imu.position": RandomizeCfg(how="offset", low=-0.1, high=0.1),
}


def build(env: str, robot: str, num_envs: int, **options: Any) -> EnvManager:
    """Return a simulation; a robot of which something is drawn has an IMU, whose errors and place are among it."""
    defaults = {"backend": "warp", "seed": 5}
    own = replace(ROBOTS.get(robot), sensors=("base_imu",)) if "randomize" in options else robot
    return simulation(own, "lee_velocity_control", env=env, num_envs=num_envs, **defaults | options)


def make_actions(num_envs: int, first: int = 0, *, width: int = 4) -> Tensor:
    number = torch.arange(first, first + num_envs, dtype=torch.float32).unsqueeze(-1)
    return torch.sin(number + torch.arange(float(width))).clamp(-0.5, 0.5)


def snapshot(gtd: Mapping[str, Tensor], rows: slice) -> dict[str, Tensor]:
    num_envs = gtd["sim_steps"].shape[0]
    shared = ("num_obstacles_in_env", "curriculum_level")
    return {k: value[rows].clone() for k, value in gtd.items() if value.shape[0] == num_envs and k not in shared}


def fly(env: EnvManager, first: int = 0, *, steps: int = 6) -> None:
    env.reset()
    number = torch.arange(first, first + env.num_envs)
    for step in range(steps):
        env.step(make_actions(env.num_envs, first))
        env.reset((number + step) % 3 == 0)
        env.render()


def assert_same(result: dict[str, Tensor], expected: dict[str, Tensor], *, within: float = 0.0) -> None:
    assert result.keys() == expected.keys()
    if within:
        for key, value in result.items():
            torch.testing.assert_close(value, expected[key], rtol=0.0, atol=within, equal_nan=True)
        return
    different = [key for key in result if not torch.equal(result[key].nan_to_num(7.0), expected[key].nan_to_num(7.0))]
    assert not different


@pytest.mark.slow
@pytest.mark.usefixtures("optimise_kernels")
@pytest.mark.parametrize(
    ("env", "robot"),
    frequent_values(
        [
            *((name, "base_quadrotor") for name in OBSTACLE_COURSES),
            ("env_with_obstacles", "base_quadrotor_with_camera_imu"),
            ("empty_env", "tinyprop"),
            ("empty_env", "neural_fly_quad"),
        ],
        [("dynamic_env", "base_quadrotor")],
    ),
)
def test_an_environment_is_the_same_among_few_and_many(env: str, robot: str) -> None:
    results = []
    for num_envs in (FEW, MANY):
        built = build(env, robot, num_envs)
        fly(built)
        results.append(snapshot(built.gtd, slice(FEW)))
    assert_same(*results)


@pytest.mark.slow
@pytest.mark.usefixtures("optimise_kernels")
def test_a_randomised_robot_in_gusts_is_the_same_among_few_many_and_alone() -> None:
    results = []
    for num_envs, first in ((FEW, 0), (MANY, 0), (1, 3)):
        built = build("empty_env", "tinyprop", num_envs, randomize=RANDOMIZE, first_env=first)
        fly(built, first)
        results.append(snapshot(built.gtd, slice(FEW)))
    assert_same(results[0], results[1])
    assert_same(results[2], {key: value[3:] for key, value in results[1].items()})


@pytest.mark.parametrize(
    ("env", "robot"),
    [("empty_env", "tinyprop"), pytest.param("landing_env", "base_quadrotor_on_skids", marks=pytest.mark.slow)],
)
def test_the_torch_backend_flies_an_environment_the_same_among_any_number(env: str, robot: str) -> None:
    many = build(env, robot, 130, backend="torch", randomize=RANDOMIZE)
    fly(many)
    for num_envs, first in ((1, 0), (1, 129), (3, 7), (4, 0), (65, 1)):
        built = build(env, robot, num_envs, backend="torch", randomize=RANDOMIZE, first_env=first)
        fly(built, first)
        assert_same(snapshot(built.gtd, slice(None)), snapshot(many.gtd, slice(first, first + num_envs)))


def test_an_environment_can_be_flown_alone_from_its_numbers() -> None:
    many = build("env_with_obstacles", "base_quadrotor_with_camera_imu", MANY)
    for _ in range(3):
        many.reset()
    fly(many)
    alone = build("env_with_obstacles", "base_quadrotor_with_camera_imu", 1, first_env=17, first_episode=3)
    fly(alone, 17)
    assert alone.gtd["episodes"].tolist() == many.gtd["episodes"][17:18].tolist()
    assert_same(snapshot(alone.gtd, slice(1)), snapshot(many.gtd, slice(17, 18)))


def test_another_seed_is_another_simulation() -> None:
    first = build("env_with_obstacles", "base_quadrotor_with_camera_imu", FEW, seed=1)
    fly(first)
    first.restart(2)
    fly(first)
    other = build("env_with_obstacles", "base_quadrotor_with_camera_imu", FEW, seed=2)
    fly(other)
    assert_same(snapshot(first.gtd, slice(None)), snapshot(other.gtd, slice(None)))
    shapes = [env.asset_manager.scene.shape_index for env in (first, other)]
    assert torch.equal(*shapes)
    third = build("env_with_obstacles", "base_quadrotor", FEW, seed=1)
    assert not torch.equal(shapes[0], third.asset_manager.scene.shape_index)


def roll_out(task: Task, first: int = 0, steps: int = 4) -> list[dict[str, Tensor]]:
    observation, _ = task.reset()
    results = [{"observation": observation["observations"].clone()}]
    vehicles = task.num_vehicles
    first *= vehicles
    number = torch.arange(first, first + task.num_envs) // vehicles
    for step in range(steps):
        task.env.rows.bodies["sim_steps"].masked_fill_((number + step) % 3 == 0, task.cfg.episode_len_steps)
        action = make_actions(task.num_envs, first, width=task.num_actions)
        observation, reward, terminated, truncated, info = task.step(action)
        row = {"observation": observation["observations"], "reward": reward, **info}
        row |= {"terminated": terminated, "truncated": truncated}
        results.append({key: value.clone() for key, value in row.items()})
    return results


AS_USERS_HAVE_THEM = ("agile_tracking_task", "gust_rejection_task", "motor_failure_task", "racing_task")
"""Those whose kernels are optimised."""

OFTEN = ("motor_failure_task", "navigation_task", "position_setpoint_task_morphy")
"""Of each kind one, of which the others have other numbers, or fewer parts; races are in ``task/commands/test_track.py``."""


@pytest.mark.parametrize("name", frequent_values(task_registry.names(), OFTEN))
def test_a_task_gives_an_environment_the_same_among_few_and_many(name: str, request: pytest.FixtureRequest) -> None:
    if name in AS_USERS_HAVE_THEM:
        request.getfixturevalue("optimise_kernels")
    curriculum = task_registry.get(name).curriculum
    level = None if curriculum is None else curriculum.first_level + 5
    rows = task_registry.get(name).num_vehicles
    rounding = 0.0 if task_registry.get(name).encoder is None else 1e-4  # convolutions sum by the size of a batch
    runs = {}
    for num_envs, first in ((FEW, 0), (MANY, 0), (1, 2)):
        task = task_registry.make_task(name, num_envs=num_envs, device="cpu", seed=1, level=level, first_env=first)
        runs[num_envs] = roll_out(task, first)
    for few, many, alone in zip(*(runs[n] for n in (FEW, MANY, 1)), strict=True):
        assert_same(few, {key: value[: FEW * rows] for key, value in many.items()}, within=rounding)
        assert_same(alone, {key: value[2 * rows : 3 * rows] for key, value in many.items()}, within=rounding)


def test_a_seed_given_to_a_reset_makes_a_new_task() -> None:
    runs = []
    for seed, again in ((1, 2), (2, 2)):
        task = task_registry.make_task("navigation_task", num_envs=FEW, device="cpu", seed=seed)
        if seed != again:
            roll_out(task)
        task.reset(seed=again)
        task.env.restart(again)
        runs.append(roll_out(task))
    for first, second in zip(*runs, strict=True):
        assert_same(first, second)
