"""Patterns of third-party projects on the Aerial Gym Simulator, written anew: each works, or names the alternative."""

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from aerial_gym.compat import SimBuilder, env_config_registry, robot_registry
from aerial_gym.compat.config.environments import translate_environment
from aerial_gym.compat.config.robots import translate_robot
from aerial_gym.compat.vae import VAEImageEncoder
from aerial_gym.errors import CapabilityError, ConfigError, UnknownNameError
from tests.refusals import assert_refused

BALL = '<robot name="ball"><link name="ball"><collision><geometry><sphere radius="0.2"/></geometry></collision></link></robot>'


@pytest.fixture
def clutter(tmp_path: Path) -> type:
    """A forest with obstacles of the project's own, derived from names of that simulator's asset module."""
    from aerial_gym.config.asset_config.env_object_config import (
        asset_state_params,
        bottom_wall,
        thin_asset_params,
        tile_asset_params,
        tree_asset_params,
    )

    (tmp_path / "ball.urdf").write_text(BALL)

    class sphere_asset_params(asset_state_params):
        num_assets = 6
        asset_folder = str(tmp_path)
        min_state_ratio = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        max_state_ratio = [0.9, 0.9, 0.9, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        keep_in_env = False
        semantic_id = 5

    class open_wall(bottom_wall):
        keep_in_env = False

    class Clutter:
        class env:
            num_physics_steps_per_env_step_mean = 3
            num_physics_steps_per_env_step_std = 0
            e_s = 6.0  # half of the edge
            lower_bound_min = lower_bound_max = [-e_s, -e_s, -1.0]
            upper_bound_min = upper_bound_max = [e_s, e_s, 4.0]

        class env_config:
            include_asset_type = {"spheres": True, "trees": True, "thin": True, "bottom_wall": True, "tiles": False}
            asset_type_to_dict_map = {
                "spheres": sphere_asset_params, "trees": tree_asset_params, "thin": thin_asset_params,
                "bottom_wall": open_wall, "tiles": tile_asset_params,
            }  # fmt: skip

    return Clutter


def test_own_obstacles_from_asset_state_params(clutter: type) -> None:
    cfg = translate_environment(clutter)
    assert {asset.name: asset.count for asset in cfg.assets} == {"spheres": 6, "trees": 1, "thin": 10, "bottom_wall": 1}
    assert cfg.bounds_lower_low == (-6.0, -6.0, -1.0)
    assert not next(asset for asset in cfg.assets if asset.name == "bottom_wall").keep
    env_config_registry.register("clutter", clutter)
    env = SimBuilder().build_env("base_sim", "clutter", "base_quadrotor", "lee_velocity_control", "cpu", num_envs=2)
    env.reset()
    env.step(torch.zeros(2, 4))
    assert env.obstacle_manager.obstacle_position.shape == (2, 18, 3)
    assert env.IGE_env.global_tensor_dict is env.get_obs()


def test_tiles_without_meshes_are_refused_when_they_are_included(clutter: type) -> None:
    clutter.env_config.include_asset_type = {"tiles": True}
    words = "asset_folder = '.*tile_meshes'.* Give URDF files, or leave the asset out of include_asset_type"
    assert_refused(ConfigError, words, translate_environment, clutter)


def test_a_number_of_obstacles_of_zero_is_set_on_the_class_before_building() -> None:
    from aerial_gym.config.asset_config.env_object_config import object_asset_params, panel_asset_params
    from aerial_gym.config.env_config.env_with_obstacles import EnvWithObstaclesCfg

    try:
        panel_asset_params.num_assets = object_asset_params.num_assets = 0
        names = [asset.name for asset in translate_environment(EnvWithObstaclesCfg).assets]
    finally:
        panel_asset_params.num_assets, object_asset_params.num_assets = 3, 35
    assert len(names) == 6
    assert all(name.endswith("_wall") for name in names)


def test_a_robot_class_with_euler_angles_and_attributes_of_its_own() -> None:
    from aerial_gym.config.robot_config.lmf2_config import LMF2Cfg
    from aerial_gym.config.sensor_config.lidar_config.base_lidar_config import BaseLidarConfig

    class ScanConfig(BaseLidarConfig):
        height, width = 8, 32
        euler_frame_rot_deg = [0.0, 0.0, 0.0]
        randomize_placement = False
        scan_rows = 4

    class ProjectCfg(LMF2Cfg):
        class sensor_config(LMF2Cfg.sensor_config):
            enable_camera = False
            enable_lidar = True
            lidar_config = ScanConfig

        class robot_asset(LMF2Cfg.robot_asset):
            min_euler_angles = [-0.5, -0.5, -3.1]
            max_euler_angles = [0.5, 0.5, 3.1]
            safe_distance = 0.4

    cfg = translate_robot(ProjectCfg)
    assert (cfg.body.mass, len(cfg.sensors)) == (1.24, 1)
    assert str(cfg.sensors[0]).startswith("scan_config")


def test_stages_of_a_step_and_forces_are_refused_with_the_alternative() -> None:
    """One project runs the stages itself, in order to add forces between them."""
    names = ("base_sim", "empty_env", "base_quadrotor", "lee_position_control", "cpu")
    env = SimBuilder().build_env(*names, num_envs=1)
    env.reset()
    way = r"env_manager.step\(actions, env_actions\) does a whole step. A force on the robot is an effect"
    for part, name in (
        (env, "reset_tensors"), (env.robot_manager, "pre_physics_step"), (env.asset_manager, "pre_physics_step"),
        (env.obstacle_manager, "pre_physics_step"), (env.IGE_env, "physics_step"), (env, "post_physics_step"),
    ):  # fmt: skip
        assert_refused(AttributeError, f"{name}: {way}", getattr, part, name)
    assert_refused(
        AttributeError, "obstacle_manager.warp: the simulation itself is", getattr, env.obstacle_manager, "warp"
    )
    assert_refused(
        UnknownNameError, "'robot_force_tensor': .* An effect adds one", env.get_obs().__getitem__, "robot_force_tensor"
    )
    state = torch.zeros(13)
    state[6] = 1.0
    env.IGE_env.global_tensor_dict["vec_root_tensor"][:, 0, :13] = state
    env.IGE_env.write_to_sim()
    assert torch.equal(env.get_obs()["robot_position"], torch.zeros(1, 3))


def encoder_config(**changes: Any) -> SimpleNamespace:
    values = {"latent_dims": 64, "model_folder": "/nowhere", "model_file": "weights.pth", "image_res": (270, 480)}
    return SimpleNamespace(**values | {"interpolation_mode": "nearest", "return_sampled_latent": True} | changes)


def test_latents_of_images(caplog) -> None:
    from aerial_gym.utils.vae.vae_image_encoder import VAEImageEncoder as Imported

    assert Imported is VAEImageEncoder
    with caplog.at_level(logging.WARNING, logger="aerial_gym.compat"):
        encoder = Imported(config=encoder_config(), device="cpu")
    assert "model_file = '/nowhere/weights.pth': no such file" in caplog.text
    assert "'collision_40x24' takes its place, so train policies again" in caplog.text
    images = torch.rand(3, 135, 240, generator=torch.Generator().manual_seed(0))
    latents = encoder.encode(images)
    assert latents.shape == (3, encoder.get_latent_dims_size()) == (3, 64)
    torch.testing.assert_close(encoder.encode(images.unsqueeze(0)), latents)
    torch.testing.assert_close(encoder.encode(images[:1]), latents[:1], rtol=1e-4, atol=1e-5)
    near = torch.where(images < 0.5, -1.0, images)
    torch.testing.assert_close(encoder.encode(near), encoder.encode(near.clamp_min(0.0)))
    assert_refused(CapabilityError, "encoder files have no decoder", encoder.decode, latents)
    assert_refused(
        ConfigError, "latent_dims = 32: the encoder has 64. Train one", VAEImageEncoder, encoder_config(latent_dims=32)
    )


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    torch.save({"encoder.weight": torch.zeros(3)}, tmp_path / "weights.pth")
    words = "weights.pth.* Train one with aerial-gym train-encoder"
    assert_refused(ConfigError, words, VAEImageEncoder, encoder_config(model_folder=str(tmp_path)), "cpu")


@pytest.mark.parametrize("robot", [["lmf2", "x500"], ("lmf2",), {"a": "lmf2"}])
def test_several_robots_are_refused_with_the_alternative(robot: Any) -> None:
    names = ("base_sim", "empty_env", robot, "no_control", "cpu")
    words = "robot_name = .*: there is one vehicle here; build_env"
    assert_refused(CapabilityError, words, SimBuilder().build_env, *names)


def test_robots_of_that_simulator_are_registered_by_their_classes() -> None:
    from aerial_gym.config.robot_config.snakey_config import SnakeyCfg
    from aerial_gym.robots.base_reconfigurable import BaseReconfigurable

    robot_registry.register("my_snake", BaseReconfigurable, SnakeyCfg)
    assert robot_registry.native_config("my_snake").joints is not None
