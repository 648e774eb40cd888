"""Configuration classes: each attribute of each table is carried over, without effect, or refused with the way out."""

import logging
from typing import Any

import pytest

from aerial_gym.compat.config import assets, controllers, environments, imus, robots, sensors, sims, tasks
from aerial_gym.compat.config import fields as fields_module
from aerial_gym.compat.config.fields import STANDS_FOR, ConfigField, ConfigTable
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RotorCfg
from aerial_gym.errors import ConfigError
from docs.generate.aerial_gym_names import TABLES
from tests.refusals import assert_refused

URDF = '<robot name="post"><link name="post"><collision><geometry><box size="0.2 0.2 1"/></geometry></collision></link></robot>'

CLASSES: dict[str, Any] = {
    "Sims": sims.BaseSimConfig, "Environments": environments.CLASSES["env_with_obstacles"],
    "Obstacles": assets.CLASSES["panels"], "Robots": robots.CLASSES["base_quadrotor_with_camera_imu"],
    "Cameras": sensors.CLASSES["stereo_camera"], "Lidars": sensors.CLASSES["base_lidar"],
    "IMUs": imus.CLASSES["bmi088"], "Gains of controllers": controllers.control,
    "Tasks of this package": tasks.task_class_config("navigation_task"),
}  # fmt: skip
"""A class of each table in which every field has a value."""

OTHER: dict[str, Any] = {
    "sim.gravity": [0.0, 0.0, -1.62],
    "sensor_type": "normal_faceID_camera",
    "env_config.include_asset_type": {"panels": True},
    "env_config.asset_type_to_dict_map": {"panels": assets.CLASSES["trees"]},
    "sensor_config.enable_lidar": True,
    "sensor_config.camera_config": sensors.CLASSES["rs_d455"],
    "sensor_config.imu_config": imus.CLASSES["vn100"],
    "damping.linvel_linear_damping_coefficient": [0.1, 0.2, 0.3],
    "damping.linvel_quadratic_damping_coefficient": [0.1, 0.2, 0.3],
    "control_allocator_config.motor_model_config.min_thrust": 0.1,
    "control_allocator_config.allocation_matrix": [
        *([0.0] * 4, [0.0] * 4, [1.0] * 4),
        *([-0.2, -0.2, 0.2, 0.2], [-0.2, 0.2, 0.2, -0.2], [-0.01, 0.01, -0.01, 0.01]),
    ],
    "min_translation": [0.0, -0.1, 0.0],
    "min_euler_rotation_deg": [-9.0, -9.0, -9.0],
    "nominal_position": [0.08, 0.0, 0.02],
    "nominal_orientation_euler_deg": [1.0, 2.0, 3.0],
    "max_inclination_angle_rad": 0.7,
    "horizontal_fov_deg_min": -170.0,
    "horizontal_fov_deg_max": 170.0,
    "min_state_ratio": [0.1, 0.0, 0.0, -0.1, -0.1, -1.2, 1.0, 0, 0, 0, 0, 0, 0],
    "init_config.min_init_state": [0.0, 0.1, 0.1, -0.1, -0.1, -1.0, 1.0, -0.3, -0.3, -0.3, -0.3, -0.3, -0.3],
    "target_min_ratio": (0.1, 0.2, 0.3),
    "target_max_ratio": (0.95, 0.9, 0.9),
    "sim_name": "base_sim_2ms",
    "env_name": "empty_env",
    "robot_name": "tinyprop",
    "controller_name": "lee_attitude_control",
    "success_rate_for_decrease": 0.5,
    "curriculum.success_rate_for_decrease": 0.5,
}
"""Values other than the plain ones, where a number or a truth will not do."""

NEEDS: dict[str, dict[str, Any]] = {
    "pointcloud_in_world_frame": {"return_pointcloud": True},
    "sensor_config.lidar_config": {"sensor_config.enable_lidar": True},
    "per_link_semantic": {"asset_folder": "URDF"},
    "semantic_masked_links": {"asset_folder": "URDF"},
    "file": {"asset_folder": "URDF"},
    "sensor_noise.std_a": {"sensor_noise.std_b": 0.0},
    "control_allocator_config.allocation_matrix": {"control_allocator_config.force_application_level": "root_link"},
    "disturbance.prob_apply_disturbance": {"disturbance.enable_disturbance": True},
    "disturbance.max_force_and_torque_disturbance": {"disturbance.enable_disturbance": True},
}
"""What else must be set so that a field says something."""


KEPT = {
    "env.num_envs", "env.reset_on_collision", "robot_asset.disable_gravity", "robot_asset.fix_base_link",
    "control_allocator_config.force_application_level", "dof_control_mode", "num_actions", "device", "seed",
    "return_state_before_reset",
    *(f"reconfiguration_config.{name}" for name in ("dof_mode", "init_state_min", "init_state_max", "stiffness", "damping")),
}  # fmt: skip
"""Fields that are read where they are needed, and not written into our configuration."""


def other_value(field: ConfigField, value: Any) -> Any:
    if field.script_name in OTHER:
        return OTHER[field.script_name]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return 1.01 * value + 0.001
    if isinstance(value, dict):
        return {key: 2.0 * number for key, number in value.items()} or {"post": 7}
    if isinstance(value, (list, tuple)) and all(isinstance(entry, (int, float)) for entry in value):
        return [1.01 * entry + 0.001 for entry in value]
    return "another"


def make_subclass(parent: type, values: dict[str, Any]) -> type:
    """Return a class derived from a configuration class with other values, written as scripts write it."""
    made = type("Mine", (parent,), {})
    for path, value in values.items():
        node, inherited = made, parent
        *sections, last = path.split(".")
        for section in sections:
            inherited = getattr(inherited, section)
            if section not in vars(node):
                setattr(node, section, type(section, (inherited,), {}))
            node = vars(node)[section]
        setattr(node, last, value)
    return made


TOGETHER = {
    "Robots control_allocator_config.num_motors", "Robots control_allocator_config.motor_directions",
    "Robots robot_asset.asset_folder", "Robots robot_asset.file",
    "IMUs min_euler_rotation_deg", "IMUs max_euler_rotation_deg",
}  # fmt: skip
"""Fields that mean something with others alone: ``test_bodies``, ``test_an_imu_of_one_s_own``."""

CASES = [(title, table, field) for title, table in TABLES for field in table.fields]
CASES = [case for case in CASES if f"{case[0]} {case[2].script_name}" not in TOGETHER]


@pytest.mark.parametrize(("title", "table", "field"), CASES, ids=[f"{t} {f.script_name}" for t, _, f in CASES])
def test_every_attribute_does_what_the_table_says(title, table, field, tmp_path, caplog) -> None:
    parent = CLASSES[title]
    stands_for = getattr(parent, STANDS_FOR)
    (tmp_path / "post.urdf").write_text(URDF)
    values = {
        key: str(tmp_path) if value == "URDF" else value for key, value in NEEDS.get(field.script_name, {}).items()
    }
    before = table.translate(make_subclass(parent, values), stands_for)
    new = other_value(field, field.read(stands_for))
    if field.script_name == "asset_folder":
        new = str(tmp_path)
    elif field.script_name == "file":
        new = "post.urdf"
        (tmp_path / "other.urdf").write_text(URDF)
        before = table.translate(make_subclass(parent, values), stands_for)
    cls = make_subclass(parent, values | {field.script_name: new})
    if field.refused:
        assert_refused(ConfigError, f"Mine.{field.script_name} = ", table.translate, cls, stands_for)
        assert field.remark
        return
    fields_module._logged.clear()
    with caplog.at_level(logging.INFO, logger="aerial_gym"):
        after = table.translate(cls, stands_for)
    if field.write is None:
        assert f"{field.script_name}" in caplog.text
        assert "without effect here" in caplog.text
        assert field.remark
    changes = field.write is not None and field.script_name not in KEPT
    assert (after != before) == changes


@pytest.mark.parametrize(("title", "table"), TABLES, ids=[title for title, _ in TABLES])
def test_a_class_stands_for_its_configuration(title: str, table: ConfigTable) -> None:
    parent = CLASSES[title]
    stands_for = getattr(parent, STANDS_FOR)
    assert table.translate(parent, stands_for) == stands_for
    assert table.translate(parent(), stands_for) == stands_for
    assert table.translate(make_subclass(parent, {}), stands_for) == stands_for


@pytest.mark.parametrize("name", ["lower_bound_mim", "num_env", "env_spacings", "reset_on_colision"])
def test_a_misspelled_field_is_refused(name: str) -> None:
    cls = make_subclass(CLASSES["Environments"], {f"env.{name}": 1})
    assert_refused(ConfigError, f"Mine.env.{name} = 1: .* Did you mean", environments.translate_environment, cls)


@pytest.mark.parametrize("name", ["e_s", "room_size", "max_height", "goal", "curriculum_levels", "lower_left"])
def test_an_attribute_of_one_s_own_is_taken(name: str) -> None:
    cls = make_subclass(CLASSES["Environments"], {f"env.{name}": 1, name: type("Section", (), {"deep": 2})})
    assert environments.translate_environment(cls) == environments.translate_environment(CLASSES["Environments"])


def test_a_misspelled_attribute_is_refused_and_a_section_that_means_nothing_is_not() -> None:
    cls = make_subclass(CLASSES["Environments"], {"env.lower_bound_mim": [0, 0, 0]})
    words = r"Mine.env.lower_bound_mim = \[0, 0, 0\]: no such field \(environment\). Did you mean 'env.lower_bound_min'"
    assert_refused(ConfigError, words, environments.translate_environment, cls)
    cls = make_subclass(CLASSES["Environments"], {"env._my_own_note": 3})
    assert environments.translate_environment(cls) == environments.translate_environment(CLASSES["Environments"])

    class Sim(sims.BaseSimConfig):
        class viewer:
            camera_position = [-5, -5, 4]

        class sim(sims.BaseSimConfig.sim):
            class physx:
                num_threads = 10

    assert sims.translate_sim(Sim) == sims.translate_sim(sims.BaseSimConfig)


def test_changes_are_made_all_at_once() -> None:
    class Far:
        class env:
            lower_bound_min = lower_bound_max = [100.0, 100.0, 100.0]
            upper_bound_min = upper_bound_max = [120.0, 120.0, 120.0]

    cfg = environments.translate_environment(Far)
    assert cfg.bounds_lower_low == (100.0, 100.0, 100.0)
    assert cfg.bounds_upper_high == (120.0, 120.0, 120.0)
    assert cfg.assets == ()


def test_asset_classes_are_read_when_something_is_built() -> None:
    panels = assets.CLASSES["panels"]
    try:
        panels.num_assets = 7
        cfg = environments.translate_environment(CLASSES["Environments"])
        assert next(a.count for a in cfg.assets if a.name == "panels") == 7
        panels.num_assets = 0
        assert "panels" not in [a.name for a in environments.translate_environment(CLASSES["Environments"]).assets]
    finally:
        panels.num_assets = 3
    assert environments.translate_environment(CLASSES["Environments"]) == getattr(CLASSES["Environments"], STANDS_FOR)


def test_folders_of_that_simulator_have_shapes_here() -> None:
    class TreeAssets(assets.BaseAssetParams):
        asset_folder = "/nowhere/aerial_gym/resources/models/environment_assets/trees"

    cfg = assets.translate_asset("wood", TreeAssets)
    assert (cfg.name, cfg.family.name) == ("wood", "trees")

    class EmptyAssets(assets.BaseAssetParams):
        asset_folder = "/nowhere/houses"

    words = "asset_folder = '/nowhere/houses', file = None: no such URDF file. Those of that simulator with shapes here: panels"
    assert_refused(ConfigError, words, assets.translate_asset, "houses", EmptyAssets)

    class Bare(assets.BaseAssetParams):
        num_assets = 2

    assert_refused(ConfigError, "Bare.asset_folder: must be given", assets.translate_asset, "bare", Bare)


def test_units_and_modes_of_the_motor_model() -> None:
    """1.376e-5 N per (rev/s)² is that over (2 pi)² per (rad/s)²; the middle of a range counts."""
    ends = {"motor_thrust_constant_min": 1.0e-5, "motor_thrust_constant_max": 1.752e-5}
    assert make_rotor(**ends).thrust_map == pytest.approx((0.0, 0.0, 1.376e-5 / 39.47841760435743))
    rotor = make_rotor(use_rps=False, min_thrust=-5.0, max_thrust=5.0, max_thrust_rate=200.0)
    assert (rotor.mode, rotor.thrust_map) == ("force", (0.0,) * 3)
    assert (rotor.thrust_range, rotor.slew_rate) == ((-5.0, 5.0), 200.0)


def make_rotor(**values: object) -> RotorCfg:
    motor = "control_allocator_config.motor_model_config"
    cls = make_subclass(robots.BaseQuadCfg, {f"{motor}.{name}": value for name, value in values.items()})
    return robots.translate_robot(cls).rotor


def test_depth_of_cameras_there_is_divided_by_the_range() -> None:
    cfg = sensors.translate_sensor(sensors.CLASSES["base_depth_camera"])
    assert cfg.normalize
    assert (cfg.far_pixel, cfg.near_pixel) == (1.0, -1.0)
    assert sensors.sensor_catalog_name(sensors.CLASSES["stereo_camera"]) == "stereo_camera"


def test_an_imu_of_one_s_own() -> None:
    assert imus.imu_catalog_name(imus.CLASSES["bmi088"]) == "bmi088"

    class Noisy(sensors.BaseSensorConfig):
        sensor_type = "imu"
        imu_noise_std = [0.1, 0.1, 0.2, 0.01, 0.01, 0.02]
        bias_std = [1.0] * 6
        enable_bias = False

    cfg = imus.translate_imu(Noisy)
    assert (cfg.accel_noise_density, cfg.gyro_noise_density) == ((0.1, 0.1, 0.2), (0.01, 0.01, 0.02))
    assert cfg.accel_bias_walk == cfg.gyro_bias_walk == cfg.gyro_initial_bias == (0.0,) * 3
    name = imus.imu_catalog_name(Noisy)
    assert (name, imus.imu_catalog_name(Noisy)) == ("noisy", name)
    turned = {"randomize_placement": True}
    turned |= {"min_euler_rotation_deg": [-1.0, -2.0, 0.0], "max_euler_rotation_deg": [1.0, 2.0, 0.0]}
    assert imus.translate_imu(make_subclass(Noisy, turned)).misalignment_deg == (1.0, 2.0, 0.0)
    with pytest.raises(ConfigError, match="max_euler_rotation_deg = .* must lie about 0"):
        imus.translate_imu(make_subclass(Noisy, turned | {"min_euler_rotation_deg": [0.0, 0.0, 1.0]}))


def test_gains_of_a_class_are_explicit_gains() -> None:
    class Quick(controllers.control):
        K_rot_tensor_min = [1.6, 1.6, 0.4]
        K_rot_tensor_max = [1.5, 1.7, 0.5]
        randomize_params = True

    cfg = controllers.translate_controller(controllers.LAWS["LeeAttitudeController"], Quick)
    assert (cfg.gains.attitude, cfg.if_unstable) == (pytest.approx((1.55, 1.65, 0.45)), "warn")
    drawn = controllers.gain_randomization(controllers.LAWS["LeeAttitudeController"], Quick)
    assert drawn["gains.attitude"] == RandomizeCfg(how="value", low=(1.5, 1.6, 0.4), high=(1.6, 1.7, 0.5))
    assert drawn["gains.position"] == RandomizeCfg(how="value", low=(2.0, 2.0, 1.0), high=(3.0, 3.0, 2.0))
    assert drawn.keys() == {"gains.position", "gains.velocity", "gains.attitude", "gains.rate"}
    assert not controllers.gain_randomization(controllers.LAWS["NoControl"], Quick)
    assert_refused(ConfigError, "controller class", controllers.translate_controller, type("MyLaw", (), {}), Quick)
