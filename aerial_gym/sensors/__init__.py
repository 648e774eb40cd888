"""Sensors on board: cameras, lidars and arbitrary rays."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.sensors.catalog import SENSORS
    from aerial_gym.sensors.images import SensorImages, make_images
    from aerial_gym.sensors.imu import Imu
    from aerial_gym.sensors.ray_caster import MISS_ID, RayCaster
    from aerial_gym.sensors.rays import pinhole_rays, ray_table
    from aerial_gym.sensors.sensor_manager import SensorManager

__all__ = [
    "MISS_ID",
    "SENSORS",
    "Imu",
    "RayCaster",
    "SensorImages",
    "SensorManager",
    "make_images",
    "pinhole_rays",
    "ray_table",
]

__getattr__, __dir__ = exports(__name__, __file__)
