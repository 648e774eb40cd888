"""Every robot that comes with the package, in one table."""

from functools import partial
from pathlib import Path

from aerial_gym.config import family_files, read_summary
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.registry import Registry

ROBOTS: Registry[RobotCfg] = Registry("robot")

_FILES = family_files("robots")

for _name in (
    "base_quadrotor",
    "tinyprop",
    "crazyflie_21_brushless",
    "crazyflie_21",
    "neural_fly_quad",
    "omnidirectional_octarotor",
    "lmf1",
    "lmf2",
    "magpie",
    "x500",
    "base_quad_root_link_control",
    "base_octarotor",
    "base_random",
    "typhoon_hexarotor",
    "tilted_hexarotor",
    "coaxial_octarotor",
    "racing_quadrotor",
    "base_rov",
    "bluerov2_heavy",
    "tilt_tricopter",
    "morphy",
    "morphy_fixed_base",
    "morphy_stiff",
    "morphy_creeping",
    "base_quadrotor_doubled_inertia",
    "base_quadrotor_with_camera",
    "base_quadrotor_with_coarse_camera",
    "base_quadrotor_with_imu",
    "base_quadrotor_with_camera_imu",
    "base_quadrotor_with_lidar",
    "base_quadrotor_with_dome_lidar",
    "base_quadrotor_with_coarse_dome_lidar",
    "base_quadrotor_with_stereo_camera",
    "base_quadrotor_with_faceid_normal_camera",
    "lmf2_with_camera",
    "lmf2_radar",
    "base_quadrotor_on_skids",
    "base_quadrotor_lander",
    "crazyflie_21_brushless_racing",
    "base_quadrotor_with_payload",
    "base_quadrotor_with_drag",
    "base_quadrotor_braked_in_spin",
    "base_quadrotor_in_gusts",
    "sampled_quadrotor",
    "x500_px4",
    "crazyflie_2x_arpl",
    "snakey",
    "snakey_position",
    "snakey_effort",
    "snakey5",
    "snakey5_position",
    "snakey5_effort",
    "snakey6",
    "snakey6_position",
    "snakey6_effort",
):
    _path = _FILES[_name]
    ROBOTS.register_later(_name, partial(load_robot, _path), summary=partial(read_summary, _path))


def robot_by_name(name: str | Path | RobotCfg) -> RobotCfg:
    """Return a registered robot, or the one in a robot file if ``name`` ends in ``.yaml``; configurations pass unchanged."""
    if isinstance(name, RobotCfg):
        return name
    if str(name).endswith((".yaml", ".yml")):
        return load_robot(name)
    return ROBOTS.get(str(name))
