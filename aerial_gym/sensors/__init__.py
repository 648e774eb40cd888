"""Sensors on board: cameras of depth, range and segmentation."""

from aerial_gym.sensors.catalog import SENSORS
from aerial_gym.sensors.ray_caster import MISS_ID, RayCaster
from aerial_gym.sensors.rays import pinhole_rays
from aerial_gym.sensors.sensor_manager import SensorManager

__all__ = ["MISS_ID", "SENSORS", "RayCaster", "SensorManager", "pinhole_rays"]
