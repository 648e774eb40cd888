"""Module paths of the Aerial Gym Simulator that scripts import, with their replacements.

One table, resolved by a finder that Python asks last: a path that is a real module of this package stays that module, and
nothing is imported before a script asks for it. ``aerial_gym/__init__.py`` installs it: a script needs no other
import first.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType
from typing import Any

_HOME = "aerial_gym.compat."

_CAMERAS = "config.sensor_config.camera_config"
_LIDARS = "config.sensor_config.lidar_config"
_IMUS = "config.sensor_config.imu_config"
_ASSETS = ("panels", "thin", "trees", "objects")
_WALLS = ("front_wall", "back_wall", "left_wall", "right_wall", "bottom_wall", "top_wall")

MODULES: dict[str, dict[str, str]] = {
    "sim": {"sim_config_registry": "registries:sim_config_registry"},
    "sim.sim_builder": {"SimBuilder": "sim_builder:SimBuilder"},
    **{
        f"registry.{kind}_registry": {name: f"registries:{name}"}
        for kind, name in (
            ("sim", "sim_config_registry"), ("env", "env_config_registry"), ("robot", "robot_registry"),
            ("controller", "controller_registry"), ("task", "task_registry"),
        )
    },
    "utils.logging": {"CustomLogger": "helpers:CustomLogger"},
    "utils.math": {"*": "math"},
    "utils.helpers": {"parse_arguments": "helpers:parse_arguments", "get_args": "helpers:get_args"},
    "robots.base_multirotor": {"BaseMultirotor": "registries:BaseMultirotor"},
    "robots.BaseMultirotor": {"": "registries:BaseMultirotor"},
    "task.base_task": {"BaseTask": "native_task:BaseTask"},
    "task.position_setpoint_task.position_setpoint_task": {"PositionSetpointTask": "native_task:PositionSetpointTask"},
    "task.navigation_task.navigation_task": {"NavigationTask": "native_task:NavigationTask"},
    **{
        f"config.task_config.{task}_config": {"task_config": f'config.tasks:task_class_config("{task}")'}
        for task in ("position_setpoint_task", "navigation_task")
    },
    **{
        f"config.sim_config.{module}": {cls: f"config.sims:{cls}"}
        for module, cls in (
            ("base_sim_config", "BaseSimConfig"), ("base_sim_headless_config", "BaseSimHeadlessConfig"),
            ("base_sim_no_gravity_config", "BaseSimNoGravityConfig"), ("sim_config_2ms", "SimCfg2Ms"),
            ("sim_config_4ms", "SimCfg4Ms"),
        )
    },
    **{
        f"config.env_config.{module}": {cls: f'config.environments:CLASSES["{env}"]'}
        for module, cls, env in (
            ("empty_env", "EmptyEnvCfg", "empty_env"), ("env_config_2ms", "EnvCfg2Ms", "empty_env_2ms"),
            ("env_with_obstacles", "EnvWithObstaclesCfg", "env_with_obstacles"), ("forest_env", "ForestEnvCfg", "forest_env"),
            ("dynamic_environment", "DynamicEnvironmentCfg", "dynamic_env"),
        )
    },
    "config.asset_config.base_asset": {"BaseAssetParams": "config.assets:BaseAssetParams"},
    "config.asset_config.env_object_config": {
        **{f"{name.removesuffix('s')}_asset_params": f'config.assets:CLASSES["{name}"]' for name in _ASSETS},
        **{name: f'config.assets:CLASSES["{name}"]' for name in _WALLS},
        "BaseAssetParams": "config.assets:BaseAssetParams",
    },
    "config.robot_config.base_quad_config": {
        "BaseQuadCfg": "config.robots:BaseQuadCfg",
        **{
            f"BaseQuadWith{name}Cfg": f'config.robots:CLASSES["base_quadrotor_with_{robot}"]'
            for name, robot in (
                ("Imu", "imu"), ("Camera", "camera"), ("CameraImu", "camera_imu"), ("Lidar", "lidar"),
                ("FaceIDNormalCamera", "faceid_normal_camera"), ("StereoCamera", "stereo_camera"),
            )
        },
    },
    "config.robot_config.tinyprop": {"TinyPropCfg": 'config.robots:CLASSES["tinyprop"]'},
    "config.controller_config.lee_controller_config": {"control": "config.controllers:control"},
    **{
        f"control.controllers.{module}": {law: f'config.controllers:LAWS["{law}"]'}
        for module, law in (
            ("no_control", "NoControl"), ("position_control", "LeePositionController"),
            ("velocity_control", "LeeVelocityController"), ("attitude_control", "LeeAttitudeController"),
            ("rates_control", "LeeRatesController"), ("acceleration_control", "LeeAccelerationController"),
        )
    },
    **{
        f"{folder}.{module}": {cls: f'config.sensors:CLASSES["{sensor}"]'}
        for folder, module, cls, sensor in (
            (_CAMERAS, "base_depth_camera_config", "BaseDepthCameraConfig", "base_depth_camera"),
            (_CAMERAS, "base_normal_faceID_camera_config", "BaseNormalFaceIDCameraConfig", "base_normal_face_id_camera"),
            (_CAMERAS, "d455_depth_config", "RsD455Config", "rs_d455"),
            (_CAMERAS, "luxonis_oak_d_config", "LuxonisOakDConfig", "luxonis_oak_d"),
            (_CAMERAS, "luxonis_oak_d_pro_w_config", "LuxonisOakDProWConfig", "luxonis_oak_d_pro_w"),
            (_CAMERAS, "stereo_camera_config", "StereoCameraConfig", "stereo_camera"),
            (_LIDARS, "base_lidar_config", "BaseLidarConfig", "base_lidar"),
            (_LIDARS, "os0_128_config", "OS_0_128_Config", "os0_128"),
            (_LIDARS, "os0_64_config", "OS_0_64_Config", "os0_64"),
            (_LIDARS, "os1_64_config", "OS_1_64_Config", "os1_64"),
            (_LIDARS, "os2_64_config", "OS_2_64_Config", "os2_64"),
            (_LIDARS, "osdome_64_config", "OSDome_64_Config", "os_dome_64"),
        )
    },
    "config.sensor_config.base_sensor_config": {"BaseSensorConfig": "config.sensors:BaseSensorConfig"},
    f"{_IMUS}.base_imu_config": {"BaseImuConfig": 'config.imus:CLASSES["base_imu"]'},
    f"{_IMUS}.vn100_config": {"VN100Config": 'config.imus:CLASSES["vn100"]'},
    f"{_IMUS}.bosch_bmi088_config": {"BoschBMI088Config": 'config.imus:CLASSES["bmi088"]'},
}  # fmt: skip
"""Names of each module below ``aerial_gym``, and where in ``aerial_gym.compat`` each stands; ``*`` is all of a module, an empty
name what a package of ours gives as if it were its own."""

MODULES["config.sim_config.base_sim_no_gravity_config"]["BaseSimConfig"] = "config.sims:BaseSimNoGravityConfig"

GONE: dict[str, str] = {
    "control.controllers": "laws are pure functions here: aerial_gym.control.laws",
    "control.control_allocation": "the allocation follows from the rotors: aerial_gym.control.allocation",
    "control.motor_model": "rotor lag and thrust maps are aerial_gym.physics.rotors",
    "sensors.warp": "every range sensor is one kernel: aerial_gym.sensors; a new one is a YAML file",
    "sensors.imu_sensor": "aerial_gym.sensors.Imu",
    "sensors.isaacgym_camera_sensor": "there is no Isaac Gym here; cameras of the ray caster have colour too",
    "env_manager.IGE_env_manager": "there is no Isaac Gym here; the physics is aerial_gym.physics",
    "env_manager.warp_env_manager": "shapes are shared and moved by transforms: aerial_gym.assets.Scene",
    "robots.base_robot": "robots have no code of their own here; what acts on a body is an effect",
    "robots.base_reconfigurable": "robots have no code of their own here; joints are in the robot file",
    "robots.morphy": "robots have no code of their own here; the law of the arms is in the robot file",
    "rl_training.cleanrl": "training is the command aerial-gym train; aerial_gym.rl_training.gymnasium is a vector environment",
    "examples": "examples/coming_from_aerial_gym/ in the repository",
    **{
        f"config.{kind}_config": "configurations are YAML files here; classes that have a counterpart are listed there"
        for kind in ("sim", "env", "asset", "robot", "sensor", "controller", "task")
    },
    "task.custom_task": "write it as a task file or a class derived from BaseTask",
    **{
        f"task.{name}": "the task is registered by that name: task_registry.make_task makes it"
        for name in (
            "position_setpoint_task_sim2real", "position_setpoint_task_acceleration_sim2real",
            "position_setpoint_task_sim2real_end_to_end", "position_setpoint_task_sim2real_px4",
            "position_setpoint_task_reconfigurable", "position_setpoint_task_morphy",
            "lidar_navigation_task", "radar_navigation_task",
        )
    },
    "utils": "helpers that have a counterpart are listed there",
}  # fmt: skip
"""Modules of that simulator without a counterpart, with the remedy."""

_PREFIX = "aerial_gym."
_PACKAGES = {path.rsplit(".", n)[0] for path in MODULES for n in range(1, path.count(".") + 1)} | {"sim", "utils"}


class TableLoader(Loader):
    """Fills a module of the table; names are resolved at their first use."""

    def exec_module(self, module: ModuleType) -> None:
        """Fill the module with its names."""
        names = MODULES.get(module.__name__.removeprefix(_PREFIX), {})
        if "" in names:
            # Python imports a submodule for a name that the package lacks, and takes its entry in sys.modules.
            sys.modules[module.__name__] = resolve_place(names[""])
            return
        if "*" in names:
            copy_names(names["*"], module)
            return

        def load(name: str) -> Any:
            if name not in names:
                known = ", ".join(names) or "none"
                raise AttributeError(
                    f"module {module.__name__!r} has no {name!r} here. Known: {known}. "
                    "See docs/guides/coming_from_aerial_gym.md"
                )
            value = resolve_place(names[name])
            setattr(module, name, value)
            return value

        module.__dict__.update(__getattr__=load, __all__=list(names), __doc__="Names of the Aerial Gym Simulator.")


class TableFinder(MetaPathFinder):
    """Finds the modules of the table; raises with the alternative for those without a counterpart."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a module of the table, None for anything that is not of that simulator."""
        if not fullname.startswith(_PREFIX):
            return None
        name = fullname.removeprefix(_PREFIX)
        if name in MODULES or name in _PACKAGES:
            return spec_from_loader(fullname, TableLoader(), is_package=name in _PACKAGES)
        for gone, way_out in GONE.items():
            if name == gone or name.startswith(f"{gone}."):
                raise ModuleNotFoundError(
                    f"No module named {fullname!r}: it is the Aerial Gym Simulator's and has no counterpart here: {way_out}. "
                    "See docs/guides/coming_from_aerial_gym.md",
                    name=fullname,
                )
        return None


def copy_names(home: str, module: ModuleType) -> None:
    """Copy the public names of a module below ``aerial_gym.compat`` into another module."""
    helpers = import_module(_HOME + home)
    module.__dict__.update({name: getattr(helpers, name) for name in helpers.__all__}, __all__=helpers.__all__)


def resolve_place(place: str) -> Any:
    """Return the object ``module:expression`` below ``aerial_gym.compat``: a name, a table entry, or the result of a call."""
    module, _, expression = place.partition(":")
    home = import_module(_HOME + module)
    for opening, closing in (("[", "]"), ("(", ")")):
        if expression.endswith(closing):
            name, _, argument = expression[:-1].partition(opening)
            value = getattr(home, name)
            return value[argument.strip('"')] if opening == "[" else value(argument.strip('"'))
    return getattr(home, expression)


def install_finder() -> None:
    """Install the finder of the table's modules, once."""
    if not any(isinstance(finder, TableFinder) for finder in sys.meta_path):
        sys.meta_path.append(TableFinder())
