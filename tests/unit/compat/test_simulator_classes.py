"""Every robot and environment of the Aerial Gym Simulator builds from a class in its own style, from scratch."""

import logging
from dataclasses import fields, replace
from typing import Any

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.compat import SimBuilder, env_config_registry, robot_registry, sim_config_registry
from aerial_gym.compat.config import environments, robots
from aerial_gym.compat.config import fields as fields_module
from aerial_gym.compat.config.fields import values_equal
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sensor import CameraCfg
from aerial_gym.env_manager import SIMS
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import SENSORS
from tests.refusals import assert_refused
from tests.unit.compat import simulator_classes as classes


def build(env_name: str, robot_name: str) -> Any:
    """Return a simulation of two environments by the reference step, which compiles no kernel of the vehicle."""
    if "reference_2ms" not in sim_config_registry.names():
        sim_config_registry.register("reference_2ms", replace(SIMS.get("base_sim_2ms"), backend="torch"))
    return SimBuilder().build_env("reference_2ms", env_name, robot_name, "no_control", "cpu", num_envs=2, seed=0)


@pytest.mark.parametrize("name", classes.ROBOTS)
def test_every_robot_builds_and_flies(name: str) -> None:
    robot_class, cfg = classes.ROBOTS[name]
    robot_registry.register(f"own_{name}", robot_class, cfg)
    env = build("empty_env", f"own_{name}")
    env.reset()
    env.step(torch.zeros(2, env.num_robot_actions))
    tensors = env.get_obs()
    assert tensors["robot_state_tensor"].isfinite().all()
    low, high = (torch.tensor(getattr(cfg.init_config, f"{end}_init_state"))[:3] for end in ("min", "max"))
    share = (
        tensors["robot_position"] + 1.0
    ) / 2.0  # of bounds from -1 to 1 m; a step of 2 ms moves it by less than 1 mm
    assert ((share >= low - 1e-3) & (share <= high + 1e-3)).all()


FREE = {"summary", "initial_state", "sensors", "effects_source"}
"""Fields of a robot that each class states itself."""


@pytest.mark.parametrize("name", classes.ROBOTS)
def test_every_class_gives_the_robot_of_its_name(name: str) -> None:
    """Body, collision shapes, rotors, effects and control are those of the robot file; pushes are the class's own."""
    own, cfg = ROBOTS.get(name), robots.translate_robot(classes.ROBOTS[name][1])
    disturbed = classes.ROBOTS[name][1].disturbance.enable_disturbance
    assert ("random_push" in cfg.effects) == disturbed
    cfg = replace(cfg, effects={effect: cfg.effects[effect] for effect in cfg.effects if effect != "random_push"})
    different = {each.name for each in fields(RobotCfg) if getattr(own, each.name) != getattr(cfg, each.name)} - FREE
    spins = [mount.spin for mount in cfg.mounts.layout]
    assert spins == classes.ROBOTS[name][1].control_allocator_config.motor_directions
    assert [replace(mount, spin=1) for mount in cfg.mounts.layout] == [replace(m, spin=1) for m in own.mounts.layout]
    assert replace(cfg.rotor, thrust_map=own.rotor.thrust_map) == own.rotor
    assert cfg.rotor.thrust_map == pytest.approx(own.rotor.thrust_map, rel=3e-4)  # the middle of a range, rounded
    assert different <= {"rotor", "mounts", "joints"}
    assert ("mounts" in different) <= (name.startswith("snakey") or name == "morphy_stiff")  # other directions there
    assert (cfg.joints is None) == (own.joints is None)
    if cfg.joints is not None:
        drives = [joint.drive for joint in cfg.joints.layout]
        assert drives == [joint.drive for joint in own.joints.layout]
        assert cfg.joints.floating == own.joints.floating


def test_sensors_of_a_class_are_on_board() -> None:
    sensors = {name: robots.translate_robot(cfg).sensors for name, (_, cfg) in classes.ROBOTS.items()}
    assert sensors["base_quadrotor"] == sensors["x500"] == ()
    assert sensors["lmf2_radar"] == ("fake_radar",)
    assert sensors["magpie"] == ("rslidar_airy",)
    assert sensors["base_quadrotor_with_imu"] == ("base_imu",)
    camera, imu = sensors["base_quadrotor_with_camera_imu"]
    assert isinstance(SENSORS.get(camera), CameraCfg)
    assert imu == "base_imu"


PUSHES = {
    "enable_disturbance": True,
    "prob_apply_disturbance": 1.0,
    "max_force_and_torque_disturbance": [0.0, 0.0, 2.0, 0, 0, 0],
}


def velocity_after_a_step(**pushes: Any) -> torch.Tensor:
    """Return the velocity of two vehicles after 2 ms at thrust 0, m/s."""
    cfg = type("Mine", (robots.BaseQuadCfg,), {"disturbance": type("disturbance", (), PUSHES | pushes)})
    name = f"pushed_{len(robot_registry.names())}"
    robot_registry.register(name, classes.BaseMultirotor, cfg)
    env = build("empty_env", name)
    env.reset()
    env.step(torch.zeros(2, 4))
    return env.get_obs()["robot_body_linvel"].clone()


def test_pushes_act_as_a_class_says() -> None:
    """At most ``F dt / m`` = 2 N 0.002 s / 0.25 kg = 0.016 m/s along body z, another one for each vehicle."""
    still = velocity_after_a_step(enable_disturbance=False)
    assert torch.equal(velocity_after_a_step(prob_apply_disturbance=0.0), still)
    push = velocity_after_a_step() - still
    assert push[:, :2].abs().max() < 1e-5
    assert 1e-4 < push[:, 2].abs().min() <= push[:, 2].abs().max() <= 0.016
    assert push[0, 2] != push[1, 2]


def test_robots_of_that_simulator_keep_its_pushes_and_a_class_can_turn_them_off() -> None:
    pushed = {name for name, cls in robots.CLASSES.items() if "random_push" in robots.translate_robot(cls).effects}
    snakes = {"morphy_stiff", "snakey", "snakey5", "snakey6"}
    assert pushed == snakes | {"base_octarotor", "base_random", "base_rov", "lmf2_with_camera", "lmf2_radar", "magpie"}
    quiet = type("Quiet", (robots.CLASSES["magpie"],), {})
    quiet.disturbance = type("disturbance", (quiet.disturbance,), {"enable_disturbance": False})
    chances = [
        robots.translate_robot(cls).effects["random_push"]["probability"] for cls in (robots.CLASSES["magpie"], quiet)
    ]
    assert chances == [0.05, 0.0]


def test_joint_states_gains_and_a_held_base_are_those_of_the_class() -> None:
    held = robots.translate_robot(classes.ROBOTS["morphy_fixed_base"][1]).joints
    assert held is not None
    assert not held.floating
    assert [joint.initial for joint in held.layout] == [(0.29, 0.29), (0.0, 0.0)] * 4
    snake = robots.translate_robot(classes.snake_class("snakey5", 5, "position"))
    assert snake.joints is not None
    assert [joint.drive.mode for joint in snake.joints.layout if joint.drive] == ["position"] * 8
    assert snake.joints.layout[0].initial == pytest.approx((-1.5707963, 1.5707963))
    assert {joint.initial_rate for joint in snake.joints.layout} == {(-0.1, 0.1)}
    stiff = classes.snake_class("snakey", 4, "position")
    stiff.reconfiguration_config.stiffness = [80.0] * 6
    drives = [joint.drive for joint in robots.translate_robot(stiff).joints.layout]
    assert [drive.stiffness for drive in drives] == [80.0] * 6
    assert robots.translate_robot(classes.snake_class("snakey6", 6, "effort")).joints.layout[0].drive.mode == "effort"


def morphy(**changes: Any) -> type:
    joints = type("reconfiguration_config", (classes.arms,), changes)
    return classes.robot_class("morphy/morphy.urdf", **classes.MORPHY, joints=joints)


def quad(**changes: Any) -> type:
    return classes.robot_class("quad/quad.urdf", **classes.QUAD | changes)


@pytest.mark.parametrize(("cfg", "message"), [
    (morphy(damping=[10.0] * 4), "damping = .*: joints .* mode 'effort', and each row needs 8 entries"),
    (morphy(dof_mode="velocity"), "dof_mode = 'velocity'.*: joints of this robot are driven in mode 'effort'"),
    (morphy(custom_linear_damping=-1.0), "custom_linear_damping = -1.0: the law of the arms is `spring:`"),
    (quad(held=True), "fix_base_link = True: this robot has no joints here.*robot import"),
    (quad(directions=[1, -1, 1]), "of shape .6, 4.: needs a column for each of the 3 motors"),
])  # fmt: skip
def test_an_impossible_class_is_refused_with_the_alternative(cfg: type, message: str) -> None:
    assert_refused(ConfigError, message, robots.translate_robot, cfg)


def test_a_matrix_that_contradicts_the_motor_links_is_named_and_places_rotors_on_the_root_link(caplog) -> None:
    wide = {"matrix": classes.quad_matrix(0.21, 0.01)}
    own = ROBOTS.get("base_quadrotor").mounts
    fields_module._logged.clear()
    with caplog.at_level(logging.WARNING, logger="aerial_gym.compat"):
        assert [robots.translate_robot(quad(**wide)).mounts for _ in range(2)] == [own, own]
    assert caplog.text.count("quad.urdf: allocation_matrix differs from the rotors of the robot") == 1
    root = robots.translate_robot(quad(**wide, level="root_link")).mounts.layout
    assert root[0].position == pytest.approx((0.21, -0.21, 0.0))


@pytest.mark.parametrize("name", classes.ENVIRONMENTS)
def test_every_environment_builds(name: str) -> None:
    env_config_registry.register(f"own_{name}", classes.ENVIRONMENTS[name])
    env = build(f"own_{name}", "base_quadrotor")
    env.reset()
    moves = name == "dynamic_env"
    env.step(torch.zeros(2, 4), torch.ones(2, 40, 6) if moves else None)
    assert env.IGE_env.num_assets_per_env == ENVIRONMENTS.get(name).num_assets
    assert env.get_obs()["robot_state_tensor"].isfinite().all()
    if moves:
        assert (env.obstacle_manager.obstacle_linvel == 1.0).all()


FREE_OF_ENVIRONMENTS = {"summary", "source", "clearance", "lamps", "ground_checker", "assets"}
"""Fields of an environment that no class has."""


@pytest.mark.parametrize("name", classes.ENVIRONMENTS)
def test_every_class_gives_the_environment_of_its_name(name: str) -> None:
    own, cfg = ENVIRONMENTS.get(name), environments.translate_environment(classes.ENVIRONMENTS[name])
    different = {each.name for each in fields(own) if getattr(own, each.name) != getattr(cfg, each.name)}
    assert different <= FREE_OF_ENVIRONMENTS
    assert [asset.name for asset in cfg.assets] == [asset.name for asset in own.assets]
    for asset, own_asset in zip(cfg.assets, own.assets, strict=True):
        same = ("count", "semantic_id", "family", "offset", "motion", "position_ratio_low", "position_ratio_high")
        assert [getattr(asset, each) for each in same] == [getattr(own_asset, each) for each in same]
        assert values_equal((asset.euler_low, asset.euler_high), (own_asset.euler_low, own_asset.euler_high))
        assert [shape.size for shape in asset.shapes] == [shape.size for shape in own_asset.shapes]
        assert asset.keep == own_asset.keep or name == "env_with_lidar_nav_obstacles"  # walls can be missing there


def test_modules_of_obstacles_have_every_name() -> None:
    for module in classes.MODULES:
        assert module.asset_state_params.num_assets == 1
        assert (module.FRONT_WALL_SEMANTIC_ID, module.TOP_WALL_SEMANTIC_ID, module.PANEL_SEMANTIC_ID) == (9, 14, 20)
        assert module.tile_asset_params.asset_folder.endswith("tile_meshes")
    corridor, hall, moving = classes.MODULES
    counts = [module.object_asset_params.num_assets for module in (corridor, hall, moving)]
    assert counts == [35, 70, 40]
    assert (corridor.asset_state_params.fix_base_link, moving.object_asset_params.fix_base_link) == (True, False)


def test_fields_without_effect_and_helpers_are_named_once(caplog) -> None:
    fields_module._logged.clear()
    with caplog.at_level(logging.INFO, logger="aerial_gym.compat"):
        for _ in range(2):
            environments.translate_environment(classes.ENVIRONMENTS["empty_env"])
            robots.translate_robot(classes.ROBOTS["base_octarotor"][1])
    texts = [record.getMessage() for record in caplog.records]
    assert len(texts) == len(set(texts)) == 3
    assert "environment EnvironmentCfg: without effect here: env.e_s (an attribute of its own)" in texts[0]
    assert "env.perturb_observations" in texts[0]
    warnings = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert ["octarotor.urdf: allocation_matrix differs" in text for text in warnings] == [True]
    assert any("robot_asset.min_euler_angles, robot_asset.max_euler_angles" in text for text in texts)
