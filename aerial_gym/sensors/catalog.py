"""Every range sensor and inertial measurement unit of the package: the files of ``config/sensors`` and ``config/imus``."""

from aerial_gym.config import family_files, read_summary
from aerial_gym.config.sensor import ImuCfg, RangeSensorCfg, load_imu, load_sensor
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.registry.registry import register_files

SENSORS: Registry[RangeSensorCfg] = Registry("sensor")
register_files(SENSORS, family_files("sensors"), load_sensor, summary=read_summary)
SENSORS.accept_plugins(sensor=instance_converter("aerial_gym.config.sensor:RangeSensorCfg"))

IMUS: Registry[ImuCfg] = Registry("IMU")
register_files(IMUS, family_files("imus"), load_imu, summary=read_summary)
IMUS.accept_plugins(imu=instance_converter("aerial_gym.config.sensor:ImuCfg"))
