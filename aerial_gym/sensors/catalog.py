"""Every range sensor and inertial measurement unit of the package: the files of ``config/sensors`` and ``config/imus``."""

from functools import partial

from aerial_gym.config import family_files, read_summary
from aerial_gym.config.imu import ImuCfg, load_imu
from aerial_gym.config.sensor import RangeSensorCfg, load_sensor
from aerial_gym.registry import Registry

SENSORS: Registry[RangeSensorCfg] = Registry("sensor")

for _name, _path in family_files("sensors").items():
    SENSORS.register_later(_name, partial(load_sensor, _path), summary=partial(read_summary, _path))

IMUS: Registry[ImuCfg] = Registry("IMU")

for _name, _path in family_files("imus").items():
    IMUS.register_later(_name, partial(load_imu, _path), summary=partial(read_summary, _path))
