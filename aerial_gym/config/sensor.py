"""Sensor files: one range sensor each, of the class that ``model`` names.

The common part is in ``range_sensor``, the models in ``camera``, ``lidar`` and ``rosette``; all are importable from here.
"""

from dataclasses import replace
from pathlib import Path

from aerial_gym.config.camera import CameraCfg, FisheyeCfg, StereoCfg
from aerial_gym.config.imu import ImuCfg
from aerial_gym.config.lidar import LidarCfg, PrismCfg, RayTableCfg, RosetteCfg
from aerial_gym.config.loader import build, format_value, read_yaml
from aerial_gym.config.range_sensor import FRAMES, KINDS, LightCfg, NoiseCfg, RangeSensorCfg
from aerial_gym.errors import ConfigError, suggest_name

__all__ = [
    "FRAMES", "KINDS", "MODELS", "CameraCfg", "FisheyeCfg", "LidarCfg", "LightCfg", "NoiseCfg", "PrismCfg",
    "RangeSensorCfg", "RayTableCfg", "RosetteCfg", "ScannedCfg", "SensorCfg", "StereoCfg", "load_any_sensor",
    "load_sensor",
]  # fmt: skip

MODELS: dict[str, type[RangeSensorCfg]] = {
    "pinhole": CameraCfg,
    "stereo": StereoCfg,
    "fisheye": FisheyeCfg,
    "lidar": LidarCfg,
    "ray_table": RayTableCfg,
    "rosette": RosetteCfg,
}
"""Class of each ``model``."""


ScannedCfg = LidarCfg | RosetteCfg  # A sensor that measures column after column, if its `column_duration_s` is not None
SensorCfg = RangeSensorCfg | ImuCfg  # Any sensor of a robot


def load_sensor(path: str | Path) -> RangeSensorCfg:
    """Return the range sensor in a YAML file; the path of its rays, if any, is taken relative to that file."""
    cfg = load_any_sensor(path)
    if isinstance(cfg, ImuCfg):
        raise ConfigError(f"{path}: model = 'imu': must be a range sensor, one of {', '.join(MODELS)}")
    return cfg


def load_any_sensor(path: str | Path) -> SensorCfg:
    """Return the range sensor or the IMU in a YAML file, by its ``model``; an IMU's own file may leave that out."""
    data = read_yaml(path)
    model = data.get("model")
    if model == "imu" or ("model" not in data and any(str(key).startswith(("accel_", "gyro_")) for key in data)):
        return build(ImuCfg, data, where=str(path))
    if not isinstance(model, str) or model not in MODELS:
        raise ConfigError(
            f"{path}: model = {format_value(model)}: must be one of {', '.join(MODELS)}, imu.{suggest_name(model, MODELS)}"
        )
    cfg = build(MODELS[str(model)], data, where=str(path))
    if isinstance(cfg, RayTableCfg | RosetteCfg) and cfg.path is not None:
        return replace(cfg, path=str(Path(path).resolve().parent / cfg.path))
    return cfg
