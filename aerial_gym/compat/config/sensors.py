"""Cameras and lidars: flat classes with ``sensor_noise`` inside.

There a camera's frame is turned by ``euler_frame_rot_deg`` into the optical one; here every sensor looks along its own x axis.
Angles there are degrees, here radians.
"""

import re
from dataclasses import replace
from math import degrees, radians
from typing import Any

from aerial_gym.compat.config.fields import (
    STANDS_FOR,
    Changes,
    ConfigField,
    ConfigTable,
    Values,
    idle_field,
    native_field,
    same_fields,
    unchangeable_field,
)
from aerial_gym.config.sensor import CameraCfg, LidarCfg, NoiseCfg, RangeSensorCfg, StereoCfg
from aerial_gym.errors import ConfigError
from aerial_gym.registry import Registry
from aerial_gym.sensors import SENSORS


def register_config(cls: Any, cfg: Any, registry: Registry[Any]) -> str:
    """Register a configuration once and return its name: that of an equal entry, else that of its class. A class that a script
    changes after it has been used gets a second name."""
    for known in registry:
        if registry.get(known) == cfg:
            return known
    class_name = cls.__name__ if isinstance(cls, type) else type(cls).__name__
    snake_case = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", class_name).lower()
    taken = sum(known == snake_case or known.startswith(f"{snake_case}_") for known in registry)
    name = f"{snake_case}_{taken + 1}" if taken else snake_case
    registry.register(name, cfg)
    return name


def _sensor_type(cfg: RangeSensorCfg) -> str:
    family = "lidar" if isinstance(cfg, LidarCfg) else "camera"
    if cfg.face_ids:
        return f"normal_faceID_{family}"
    return "stereo_camera" if isinstance(cfg, StereoCfg) else family


def _sensor_type_changes(values: Values) -> Changes:
    kind = str(values["sensor_type"])
    if not kind.startswith("normal_faceID"):
        raise ConfigError(
            f"sensor_type = {kind!r}: derive the class from one of that type (BaseDepthCameraConfig, StereoCameraConfig, "
            "BaseLidarConfig, BaseNormalFaceIDCameraConfig)"
        )
    return {"face_ids": True, "normals": "world"}


def _point_cloud_changes(values: Values) -> Changes:
    if not values["return_pointcloud"]:
        return {"points": None}
    return {"points": "world" if values["pointcloud_in_world_frame"] else "sensor"}


def _placement_changes(values: Values) -> Changes:
    """Return the placement fields of a sensor: the nominal pose, or limits of its draws."""
    changes: Changes = {}
    for native, nominal, low, high, unit in (
        ("position", "nominal_position", "min_translation", "max_translation", float),
        ("euler", "nominal_orientation_euler_deg", "min_euler_rotation_deg", "max_euler_rotation_deg", radians),
    ):
        middle, lowest, highest = (tuple(unit(entry) for entry in values[name]) for name in (nominal, low, high))
        if values["randomize_placement"]:
            pairs = zip(lowest, middle, highest, strict=True)
            middle = tuple(min(max(entry, a), b) for a, entry, b in pairs)
            changes |= {f"{native}_low": lowest, f"{native}_high": highest, native: middle}
        else:
            changes |= {f"{native}_low": None, f"{native}_high": None, native: middle}
    return changes


def _noise_changes(values: Values) -> Changes:
    return {
        "noise_enabled": bool(values["sensor_noise.enable_sensor_noise"]),
        "noise": NoiseCfg(
            std_a=values["sensor_noise.std_a"],
            std_b=values["sensor_noise.pixel_std_dev_multiplier"] + values["sensor_noise.std_b"],
            std_c=values["sensor_noise.std_c"],
            mean_offset=values["sensor_noise.mean_offset"],
            dropout=values["sensor_noise.pixel_dropout_prob"],
        ),
    }


def _noise_field(name: str, native: str) -> ConfigField:
    def read(cfg: RangeSensorCfg) -> float:
        return getattr(cfg.noise or NoiseCfg(), native)

    return native_field(f"sensor_noise.{name}", f"noise.{native}", read, _noise_changes)


def _angles_in_degrees(entries: Any) -> list[float]:
    return [degrees(entry) for entry in entries]


_OPTICAL = "sensors look along their own x axis here; turn nominal_orientation_euler_deg"

_COMMON = (
    *same_fields(num_sensors="count"),
    native_field("sensor_type", "model", _sensor_type, _sensor_type_changes, "which class of file: pinhole, stereo, lidar"),
    *same_fields("height", "width", "max_range", "min_range"),
    native_field("return_pointcloud", "points", lambda c: c.points is not None, _point_cloud_changes,
            "distances stay beside the points"),
    native_field("pointcloud_in_world_frame", "points", lambda c: c.points == "world", _point_cloud_changes),
    *same_fields(segmentation_camera="segmentation"),
    native_field("normalize_range", "normalize", lambda c: c.normalize,
            lambda v: {"normalize": bool(v["normalize_range"])}),
    *(native_field(f"{end}_out_of_range_value", f"{end}_out_of_range_value",
              lambda c, end=end: getattr(c, f"{end}_pixel") * (c.max_range if c.normalize else 1.0))
      for end in ("far", "near")),
    native_field("randomize_placement", "position_low, ...", lambda c: c.position_low is not None, _placement_changes,
            "without it the nominal pose holds; there the translation was then 0"),
    native_field("nominal_position", "position", lambda c: list(c.position), _placement_changes),
    native_field("nominal_orientation_euler_deg", "euler", lambda c: _angles_in_degrees(c.euler), _placement_changes),
    *(native_field(f"{end}_translation", native, lambda c, n=native: list(getattr(c, n) or c.position), _placement_changes)
      for end, native in (("min", "position_low"), ("max", "position_high"))),
    *(native_field(f"{end}_euler_rotation_deg", native,
            lambda c, n=native: _angles_in_degrees(getattr(c, n) or c.euler), _placement_changes)
      for end, native in (("min", "euler_low"), ("max", "euler_high"))),
    idle_field("use_collision_geometry", False, "a shape is the same for rays and for contact"),
    native_field("sensor_noise.enable_sensor_noise", "noise_enabled", lambda c: c.noise is not None and c.noise_enabled,
            _noise_changes, "there it failed for cameras, and spoiled point clouds"),
    _noise_field("pixel_dropout_prob", "dropout"),
    _noise_field("pixel_std_dev_multiplier", "std_b"),
    _noise_field("std_a", "std_a"),
    native_field("sensor_noise.std_b", "noise.std_b", lambda _: 0.0, _noise_changes, "added to pixel_std_dev_multiplier"),
    _noise_field("std_c", "std_c"),
    _noise_field("mean_offset", "mean_offset"),
    native_field("normal_in_world_frame", "normals", lambda c: c.normals != "sensor",
            lambda v: {"normals": "world" if v["normal_in_world_frame"] else "sensor"},
            "there normals in the sensor frame were no rotation of those in the world"),
)  # fmt: skip

CAMERA = ConfigTable(
    kind="camera",
    fields=(
        *_COMMON,
        *same_fields(horizontal_fov_deg="hfov_deg"),
        native_field("calculate_depth", "kind", lambda c: c.kind == "depth",
                lambda v: {"kind": "depth" if v["calculate_depth"] else "range"}),
        native_field("baseline", "baseline", lambda c: getattr(c, "baseline", None), remark="of a stereo camera"),
        unchangeable_field("euler_frame_rot_deg", [-90.0, 0, -90.0], _OPTICAL),
    ),
)  # fmt: skip
"""Translation of the attributes of a camera class."""

LIDAR = ConfigTable(
    kind="lidar",
    fields=(
        *_COMMON,
        *same_fields(horizontal_fov_deg_min="azimuth_low_deg", horizontal_fov_deg_max="azimuth_high_deg"),
        *same_fields(vertical_fov_deg_min="elevation_low_deg", vertical_fov_deg_max="elevation_high_deg"),
        unchangeable_field("euler_frame_rot_deg", [0.0, 0.0, 0.0], _OPTICAL),
    ),
)
"""Translation of the attributes of a lidar class."""


def translate_sensor(cls: Any) -> RangeSensorCfg:
    """Return the translated sensor of a camera or lidar class."""
    base = getattr(cls, STANDS_FOR, None)
    if base is None:
        base = SENSORS.get("base_lidar" if "lidar" in str(getattr(cls, "sensor_type", "")) else "base_depth_camera")
    return (LIDAR if isinstance(base, LidarCfg) else CAMERA).translate(cls, base)


def sensor_catalog_name(cls: Any) -> str:
    """Return the registered name of a sensor class, after registration if needed."""
    return register_config(cls, translate_sensor(cls), SENSORS)


def _make_class(sensor: str, name: str) -> type:
    """Return the class generated from a registered sensor; that simulator divides depth images by their range."""
    cfg = SENSORS.get(sensor)
    if isinstance(cfg, CameraCfg):
        cfg = replace(cfg, normalize=True)
    return (LIDAR if isinstance(cfg, LidarCfg) else CAMERA).make_class(name, cfg)


def sensor_class(sensor: str) -> type:
    """Return the configuration class of a registered sensor, the same one at every call."""
    if sensor not in CLASSES:
        CLASSES[sensor] = _make_class(sensor, sensor)
    return CLASSES[sensor]


CLASSES: dict[str, type] = {
    sensor: _make_class(sensor, name)
    for name, sensor in (
        ("BaseDepthCameraConfig", "base_depth_camera"), ("BaseNormalFaceIDCameraConfig", "base_normal_face_id_camera"),
        ("RsD455Config", "rs_d455"), ("IntelRealSenseD455Config", "intel_realsense_d455"),
        ("LuxonisOakDConfig", "luxonis_oak_d"), ("LuxonisOakDProWConfig", "luxonis_oak_d_pro_w"),
        ("StereoCameraConfig", "stereo_camera"), ("BaseLidarConfig", "base_lidar"), ("OS_0_128_Config", "os0_128"),
        ("OS_0_64_Config", "os0_64"), ("OS_1_64_Config", "os1_64"), ("OS_2_64_Config", "os2_64"),
        ("OSDome_64_Config", "os_dome_64"), ("RSLidar_Airy_Config", "rslidar_airy"), ("FakeRadarConfig", "fake_radar"),
        ("PMDFlexx2Config", "pmd_flexx2"), ("ST_VL53L5CX_Config", "tof_matrix_90"),
    )
}  # fmt: skip
"""Generated classes by the name of the sensor."""


class BaseSensorConfig:
    """Base of sensor classes written from scratch; ``sensor_type`` gives their kind."""
