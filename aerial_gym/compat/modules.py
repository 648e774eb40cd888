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
_WALLS = ("front_wall", "back_wall", "left_wall", "right_wall", "bottom_wall", "top_wall")
_ASSETS = {f"{name.removesuffix('s')}_asset_params": name for name in ("panels", "thin", "trees", "objects", "tiles")}
_ASSETS |= {name: name for name in _WALLS}
_SEMANTIC_IDS = [f"{name.upper()}_SEMANTIC_ID" for name in ("thin", "tree", "object", "panel", *_WALLS)]

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
    "utils.vae.vae_image_encoder": {"VAEImageEncoder": "vae:VAEImageEncoder"},
    **{
        f"robots.{module}": {cls: f'registries:ROBOT_CLASSES["{cls}"]'}
        for module, cls in (
            ("base_multirotor", "BaseMultirotor"), ("base_reconfigurable", "BaseReconfigurable"), ("base_rov", "BaseROV"),
            ("morphy", "Morphy"),
        )
    },
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
            ("env_with_lidar_nav_obstacles", "EnvWithLidarNavObstaclesCfg", "env_with_lidar_nav_obstacles"),
            ("env_with_obstacles", "EnvWithObstaclesCfg", "env_with_obstacles"), ("forest_env", "ForestEnvCfg", "forest_env"),
            ("dynamic_environment", "DynamicEnvironmentCfg", "dynamic_env"),
        )
    },
    "config.asset_config.base_asset": {"BaseAssetParams": "config.assets:BaseAssetParams"},
    **{
        f"config.asset_config.{module}": {
            "asset_state_params": f"config.assets:{base}",
            **{cls: f'config.assets:environment_asset("{env}/{name}")' for cls, name in _ASSETS.items()},
            **{name: f'config.assets:SEMANTIC_IDS["{name}"]' for name in _SEMANTIC_IDS},
            "AERIAL_GYM_DIRECTORY": "helpers:AERIAL_GYM_DIRECTORY",
        }
        for module, env, base in (
            ("env_object_config", "env_with_obstacles", "BaseAssetParams"),
            ("lidar_nav_env_config", "env_with_lidar_nav_obstacles", "BaseAssetParams"),
            ("dynamic_env_object_config", "dynamic_env", "MovingAssetParams"),
        )
    },
    **{
        f"config.robot_config.{module}": {cls: f'config.robots:BY_CLASS_NAME["{cls}"]' for cls in names.split()}
        for module, names in (
            ("base_quad_config", "BaseQuadCfg BaseQuadWithImuCfg BaseQuadWithCameraCfg BaseQuadWithCameraImuCfg "
             "BaseQuadWithLidarCfg BaseQuadWithFaceIDNormalCameraCfg BaseQuadWithStereoCameraCfg"),
            ("base_quad_root_link_control_config", "BaseQuadRootLinkControlCfg"), ("base_random_config", "BaseRandCfg"),
            ("base_octarotor_config", "BaseOctarotorCfg"), ("base_rov_config", "BaseROVCfg"), ("lmf1_config", "LMF1Cfg"),
            ("lmf2_config", "LMF2Cfg"), ("lmf2_radar_config", "LMF2RadarCfg"), ("magpie_config", "MagpieCfg"),
            ("x500_config", "X500Cfg"), ("morphy_config", "MorphyCfg MorphyFixedBaseCfg"), ("tinyprop", "TinyPropCfg"),
            ("morphy_stiff_config", "MorphyStiffCfg"), ("snakey_config", "SnakeyCfg"), ("snakey5_config", "Snakey5Cfg"),
            ("snakey6_config", "Snakey6Cfg"), ("tinyprop_config", "TinyPropCfg"),
        )
    },
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
            (_LIDARS, "rslidar_airy_config", "RSLidar_Airy_Config", "rslidar_airy"),
            (_LIDARS, "fake_radar_config", "fake_radar_config", "fake_radar"),
            (_LIDARS, "pmd_flexx2_config", "pmd_flexx2_config", "pmd_flexx2"),
            (_LIDARS, "st_vl53l5cx_config", "ST_VL53L5CXConfig", "tof_matrix_90"),
            (_CAMERAS, "intel_realsense_d455_config", "IntelRealSenseD455Config", "intel_realsense_d455"),
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
MODULES["config.asset_config.env_object_config"]["BaseAssetParams"] = "config.assets:BaseAssetParams"

GONE: dict[str, str] = {
    "control.controllers": "laws are pure functions here: aerial_gym.control.laws",
    "control.control_allocation": "the allocation follows from the rotors: aerial_gym.control.allocation",
    "control.motor_model": "rotor lag and thrust maps are aerial_gym.physics.rotors",
    "sensors.warp": "every range sensor is one kernel: aerial_gym.sensors; a new one is a YAML file",
    "sensors.imu_sensor": "aerial_gym.sensors.Imu",
    "sensors.isaacgym_camera_sensor": "there is no Isaac Gym here; cameras of the ray caster have colour too",
    "env_manager.IGE_env_manager": "there is no Isaac Gym here; the physics is aerial_gym.physics",
    "env_manager.warp_env_manager": "shapes are shared and moved by transforms: aerial_gym.assets.Scene",
    "env_manager.obstacle_manager": "obstacles move by twists: env_manager.step(actions, env_actions)",
    "env_manager.asset_loader": "obstacles are the assets of an environment class or file",
    "env_manager.base_env_manager": "aerial_gym.sim.sim_builder.SimBuilder builds the environment manager",
    **dict.fromkeys(("assets.warp_asset", "assets.isaacgym_asset"), "shapes are `assets:` of an environment file"),
    "robots.base_robot": "robots have no code of their own here; what acts on a body is an effect",
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
    "utils.vae": "VAEImageEncoder of aerial_gym.utils.vae.vae_image_encoder is there; aerial-gym train-encoder trains one",
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
