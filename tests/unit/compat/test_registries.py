"""The five registries: names of both simulators, classes, what cannot be had alone."""

import re
from collections.abc import Callable

import pytest
import torch

from aerial_gym import CONTROLLERS, ENVIRONMENTS, ROBOTS, SIMS
from aerial_gym import task_registry as TASKS  # noqa: N812
from aerial_gym.compat import (
    SimBuilder,
    controller_registry,
    env_config_registry,
    robot_registry,
    sim_config_registry,
    task_registry,
)
from aerial_gym.compat.config import controllers, robots, sims
from aerial_gym.compat.config.fields import copy_class
from aerial_gym.compat.registries import BaseMultirotor
from aerial_gym.config import family_files
from aerial_gym.errors import CapabilityError, ConfigError, DuplicateNameError, UnknownNameError
from tests.refusals import assert_refused

GETTERS: dict[str, Callable[[str], object]] = {
    "sim": sim_config_registry.get_sim_config, "environment": env_config_registry.get_env_config,
    "robot": robot_registry.get_robot_config, "controller": controller_registry.get_controller_config,
    "task": task_registry.get_task_config,
}  # fmt: skip


REGISTERED_THERE = {
    "robot": (
        "base_quadrotor", "base_quadrotor_with_imu", "base_quadrotor_with_camera", "base_quadrotor_with_camera_imu",
        "base_quadrotor_with_lidar", "base_quadrotor_with_faceid_normal_camera", "base_quadrotor_with_stereo_camera",
        "base_quad_root_link_control", "base_octarotor", "base_random", "base_rov", "lmf1", "lmf2", "lmf2_radar", "magpie",
        "x500", "tinyprop", "morphy", "morphy_fixed_base", "morphy_stiff", "snakey", "snakey5", "snakey6",
    ),
    "task": (
        "position_setpoint_task", "position_setpoint_task_sim2real", "position_setpoint_task_acceleration_sim2real",
        "position_setpoint_task_sim2real_end_to_end", "position_setpoint_task_sim2real_px4",
        "position_setpoint_task_reconfigurable", "position_setpoint_task_morphy", "navigation_task",
        "lidar_navigation_task", "radar_navigation_task", "dce_navigation_task",
    ),
}  # fmt: skip
"""Of the Aerial Gym Simulator 2.0.1, typed from its registries."""


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in REGISTERED_THERE.items() for name in names])
def test_what_is_registered_there_is_here(kind: str, name: str) -> None:
    assert name in {"robot": ROBOTS, "task": TASKS}[kind]
    assert GETTERS[kind](name) is not None


@pytest.mark.parametrize("kind", GETTERS)
def test_a_name_of_neither_is_refused_with_the_nearest(kind: str) -> None:
    with pytest.raises(UnknownNameError, match=re.escape(f"no {kind} 'nothing_like_it'.") + ".*Known: "):
        GETTERS[kind]("nothing_like_it")


def test_all_names_are_those_of_both() -> None:
    assert {"base_sim_headless", *SIMS} <= set(sim_config_registry.get_sim_names())
    assert set(ENVIRONMENTS) <= set(env_config_registry.get_env_names())
    assert set(ROBOTS) <= set(robot_registry.get_robot_names())
    assert set(CONTROLLERS) <= set(controller_registry.get_controller_names())
    assert set(TASKS) <= set(task_registry.get_task_names())
    assert len(task_registry.get_task_classes()) == len(task_registry.get_task_configs()) >= len(TASKS)


@pytest.mark.parametrize("name", ROBOTS.names())
def test_every_robot_of_ours_has_a_class(name: str) -> None:
    cls = robot_registry.get_robot_config(name)
    assert robot_registry.get_robot_class(name) is BaseMultirotor
    translated = robots.translate_robot(cls)
    assert (translated.body, len(translated.sensors)) == (ROBOTS.get(name).body, len(ROBOTS.get(name).sensors))
    assert robot_registry.native_config(name) in (name, translated)


def test_a_file_of_ours_and_a_frozen_configuration_are_robots() -> None:
    path = str(family_files("robots")["tinyprop"])
    assert robot_registry.native_config(path) == path
    assert robot_registry.config_class(path).init_config.min_init_state[6] == 1.0
    robot_registry.register("my_tinyprop", BaseMultirotor, ROBOTS.get("tinyprop"))
    assert robot_registry.native_config("my_tinyprop") == ROBOTS.get("tinyprop")
    assert robot_registry.get_robot_config("my_tinyprop").robot_asset.file == "robot.urdf"


def test_another_class_code_of_a_robot_or_a_part_alone_is_refused() -> None:
    class Slow(sims.BaseSimConfig):
        class sim(sims.BaseSimConfig.sim):
            dt = 0.05

    first = Slow
    sim_config_registry.register("slow", Slow)
    sim_config_registry.register("slow", Slow)
    sim_config_registry.register("base_sim", sims.BaseSimConfig)
    assert sim_config_registry.make_sim("slow") is first
    assert sim_config_registry.native_config("slow").dt == 0.05
    assert_refused(DuplicateNameError, "sim 'slow'", sim_config_registry.register, "slow", sims.BaseSimConfig)
    assert_refused(DuplicateNameError, "environment 'empty_env'", env_config_registry.register, "empty_env", Slow)
    with pytest.raises(ConfigError, match="robot class MyRobot: robots have no code of their own here"):
        robot_registry.register("mine", type("MyRobot", (BaseMultirotor,), {}), robots.BaseQuadCfg)
    with pytest.raises(CapabilityError, match="a robot is built with its environment"):
        robot_registry.make_robot("base_quadrotor", "no_control", None, "cpu")
    assert_refused(CapabilityError, "a controller", controller_registry.make_controller, "no_control", 4, "cpu")


def test_registered_gains_fly() -> None:
    class Firm(controllers.control):
        K_pos_tensor_min = K_pos_tensor_max = [4.0, 4.0, 4.0]

    law = controllers.LAWS["LeePositionController"]
    controller_registry.register_controller("firm_position_control", law, Firm)
    assert controller_registry.get_controller_class("firm_position_control") is law
    assert controller_registry.get_controller_class("lee_rates_control") is controllers.LAWS["LeeRatesController"]
    assert controller_registry.get_controller_config("firm_position_control") is Firm
    env = SimBuilder().build_env("base_sim", "empty_env", "base_quadrotor", "firm_position_control", "cpu", num_envs=2)
    env.reset()
    goal = torch.tensor([[0.2, 0.0, 0.0, 0.0]]).repeat(2, 1)
    for _ in range(400):
        env.step(actions=goal)
    torch.testing.assert_close(env.get_obs()["robot_position"], goal[:, :3], atol=0.03, rtol=0.0)


def test_randomised_gains_are_drawn_by_name() -> None:
    class RandomGains(controllers.control):
        K_rot_tensor_min, K_rot_tensor_max = [0.9, 0.9, 0.4], [1.1, 1.1, 0.6]
        K_angvel_tensor_min, K_angvel_tensor_max = [0.15, 0.15, 0.15], [0.2, 0.2, 0.2]
        randomize_params = True

    law = controllers.LAWS["LeePositionController"]
    controller_registry.register_controller("drawn_position_control", law, RandomGains)
    names = ("base_sim", "empty_env", "base_quadrotor", "drawn_position_control", "cpu")
    env = SimBuilder().build_env(*names, num_envs=64)
    env.reset()
    draws, gains = env.env.draws(), env.env.robot_manager.controller.gains
    assert draws.keys() == {"gains.position", "gains.velocity", "gains.attitude", "gains.rate"}
    for name in ("position", "velocity", "attitude", "rate"):
        assert torch.equal(draws[f"gains.{name}"], getattr(gains, name))
        assert len(getattr(gains, name).unique(dim=0)) == 64
    low, high = torch.tensor(RandomGains.K_rot_tensor_min), torch.tensor(RandomGains.K_rot_tensor_max)
    assert ((gains.attitude >= low) & (gains.attitude <= high)).all()
    before = gains.attitude.clone()
    env.env.reset(torch.arange(64) < 32)
    changed = (gains.attitude != before).all(-1)
    assert changed.tolist() == [True] * 32 + [False] * 32


def test_gains_that_all_share_can_be_changed_in_place() -> None:
    before = controllers.control.K_vel_tensor_max
    try:
        controllers.control.K_vel_tensor_max = [9.0, 9.0, 9.0]
        assert controller_registry.native_controller("lee_velocity_control").gains.velocity == (5.5, 5.5, 5.5)
        assert not controller_registry.gain_randomization("lee_velocity_control")
    finally:
        controllers.control.K_vel_tensor_max = before
    assert controller_registry.native_controller("lee_velocity_control") == "lee_velocity_control"


def test_a_task_gets_a_configuration_of_its_own() -> None:
    class Config:
        reward_parameters = {"a": 1.0}
        num_envs = 4

        class inner:
            levels = [1, 2]

    class Greedy:
        def __init__(self, task_config: type, **given: object) -> None:
            self.task_config, self.given = task_config, given
            task_config.reward_parameters["a"] = torch.tensor(2.0)
            task_config.inner.levels.append(3)
            task_config.num_envs = 8

    task_registry.register_task("greedy", Greedy, Config)
    task = task_registry.make_task("greedy", seed=3, device="cpu")
    assert task.given == {"seed": 3, "num_envs": None, "headless": None, "use_warp": None, "device": "cpu"}
    assert (Config.reward_parameters, Config.inner.levels, Config.num_envs) == ({"a": 1.0}, [1, 2], 4)
    assert copy_class(Config()).num_envs == 4
    assert task_registry.get_task_class("greedy") is Greedy
    assert task_registry.get_task_config("greedy") is Config
