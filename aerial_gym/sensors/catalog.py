"""Every sensor that comes with the package, in one table."""

from aerial_gym.config import CONFIG_DIR, load
from aerial_gym.config.sensor import CameraCfg
from aerial_gym.registry import Registry

SENSORS: Registry[CameraCfg] = Registry("sensor")

for _name in ("base_depth_camera", "depth_camera_64"):
    SENSORS.register(_name, load(CameraCfg, CONFIG_DIR / "sensors" / f"{_name}.yaml"))
