"""Every robot that comes with the package, in one table."""

from dataclasses import replace

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.registry import Registry

ROBOTS: Registry[RobotCfg] = Registry("robot")

_FOLDER = CONFIG_DIR / "robots"
_BASE = load_robot(_FOLDER / "base_quadrotor.yaml")

ROBOTS.register("base_quadrotor", _BASE)
ROBOTS.register(
    "base_quadrotor_with_camera",
    replace(_BASE, summary="base_quadrotor with a depth and segmentation camera", sensors=("base_depth_camera",)),
)
ROBOTS.register(
    "base_quadrotor_with_imu",
    replace(_BASE, summary="base_quadrotor with an inertial measurement unit", imu="base_imu"),
)
ROBOTS.register(
    "base_quadrotor_with_camera_imu",
    replace(
        _BASE,
        summary="base_quadrotor with a depth and segmentation camera and an inertial measurement unit",
        sensors=("base_depth_camera",),
        imu="base_imu",
    ),
)
ROBOTS.register(
    "base_quadrotor_with_lidar",
    replace(_BASE, summary="base_quadrotor with a lidar that sees all around", sensors=("base_lidar",)),
)
ROBOTS.register(
    "base_quadrotor_with_stereo_camera",
    replace(_BASE, summary="base_quadrotor with a stereo depth camera", sensors=("stereo_camera",)),
)
ROBOTS.register(
    "base_quadrotor_with_faceid_normal_camera",
    replace(
        _BASE,
        summary="base_quadrotor with a camera of surface normals and face ids",
        sensors=("base_normal_face_id_camera",),
    ),
)
for _name in ("tinyprop", "crazyflie_21_brushless", "crazyflie_21", "neural_fly_quad"):
    ROBOTS.register(_name, load_robot(_FOLDER / f"{_name}.yaml"))

_CRAZYFLIE = ROBOTS.get("crazyflie_21")
ROBOTS.register(
    "crazyflie_2x_arpl",
    replace(
        _CRAZYFLIE,
        summary="crazyflie_21 as the ARPL flights declare it: their rotor offsets, and rotors that follow at once",
        rotor=replace(
            _CRAZYFLIE.rotor,
            time_constant_up=0.01,
            time_constant_down=0.01,
            source=f"{_CRAZYFLIE.rotor.source} Here the lag is 0.01 s, ASSUMED: the flights were flown to find it.",
        ),
        mounts=replace(
            _CRAZYFLIE.mounts,
            layout=tuple(
                replace(m, position=tuple(0.028 / 0.0325 * p for p in m.position)) for m in _CRAZYFLIE.mounts.layout
            ),
            source="README of the ARPL flights: offsets of 0.028 m, order and signs",
        ),
    ),
)
