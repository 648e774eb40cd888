"""Sensors on board: cameras, lidars and arbitrary rays."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.sensors.catalog import IMUS, SENSORS
    from aerial_gym.sensors.images import SensorImages, make_images
    from aerial_gym.sensors.imu import Imu
    from aerial_gym.sensors.imus import ImuSet
    from aerial_gym.sensors.mounts import Pose, mounted_sensors, sensor_by_name
    from aerial_gym.sensors.ray_caster import MISS_ID, RayCaster
    from aerial_gym.sensors.rays import pinhole_rays, ray_table
    from aerial_gym.sensors.sensor_manager import SensorManager

__all__ = [
    "IMUS", "MISS_ID", "SENSORS", "Imu", "ImuSet", "Pose", "RayCaster", "SensorImages", "SensorManager",
    "make_images", "mounted_sensors", "pinhole_rays", "ray_table", "sensor_by_name",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
