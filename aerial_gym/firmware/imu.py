"""The IMU that a firmware reads: like the robot's first one, at the body origin, in every physics step.

Letters: E environments.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.sensor import ImuCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.sensors import mounted_sensors
from aerial_gym.sensors.imu import Imu
from aerial_gym.sensors.mounts import Carrier

NONE = (0.0, 0.0, 0.0)
EXACT = ImuCfg(
    summary="IMU without errors", accel_noise_density=NONE, gyro_noise_density=NONE,
    accel_bias_walk=NONE, gyro_bias_walk=NONE, accel_initial_bias=NONE,
    gyro_initial_bias=NONE, accel_range=156.9, gyro_range=34.9, source="Ranges of 16 g and 2000 deg/s",
)  # fmt: skip
"""The IMU of robots that have none."""


def make_flight_imu(env: EnvManager, *, dt: float) -> tuple[Imu, Tensor]:
    """Return the IMU for measurements every ``dt`` [s], and its measurement: force [m/s²] and rate [rad/s], body, (E, 6)."""
    keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
    position, attitude, lin_vel, ang_vel = (env.gtd[key] for key in keys)
    body = Carrier(position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=ang_vel)
    manager = env.robot_manager
    mounted = mounted_sensors(manager.cfg.sensor_mounts)[1]
    cfg = next((sensor.cfg for sensor in mounted.values()), EXACT)
    measured = torch.zeros(env.num_envs, 6)
    imu = Imu(
        replace(cfg, position=NONE, euler=NONE), body, pose=None, measurement_out=measured, dt=dt,
        gravity=env.sim_cfg.gravity, random=env.random, number=len(mounted), errors=manager.imu_errors,
    )  # fmt: skip
    return imu, measured
