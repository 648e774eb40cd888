"""Sensor files, each of the class that ``model`` names, with the models that have a lens; IMU files.

The common part of range sensors is in ``range_sensor``, with frame and letters, other models in ``lidar``; all are importable
from here. Cameras have square pixels and their principal point in the middle of the image.
An IMU's own axes are the body's (x forward, y left, z up), turned by ``euler``. Accelerometers measure specific force: +9.81
m/s² on z at hover. Noise is given as a density sigma: an average over dt has the standard deviation ``sigma / sqrt(dt)``, at
every rate. It is the two-sided density, the Allan deviation at 1 s (N of IEEE Std 952-1997). A bias walks by
``sigma_b sqrt(dt)`` in dt.
"""

from dataclasses import dataclass, replace
from math import hypot, inf
from pathlib import Path

from aerial_gym.config.checks import NO_SOURCE, Vec3, require, require_choice, require_not_negative, require_positive
from aerial_gym.config.lidar import LidarCfg, PrismCfg, RayTableCfg, RosetteCfg
from aerial_gym.config.loader import build, format_value, load, read_yaml
from aerial_gym.config.range_sensor import FRAMES, KINDS, LightCfg, NoiseCfg, RangeSensorCfg
from aerial_gym.config.sensor_mount import PlacementCfg
from aerial_gym.errors import ConfigError, suggest_name


@dataclass(frozen=True, kw_only=True)
class CameraCfg(RangeSensorCfg):
    """A pinhole camera, with rays through pixel centres."""

    model: str = "pinhole"  # Name of this model in a file
    hfov_deg: float  # Horizontal field of view, left edge to right edge [deg], 0 < hfov < 180; the vertical one follows
    kind: str = "depth"  # `depth`: distance along the optical axis; `range`: along the ray. Limits are of the same kind

    def __post_init__(self) -> None:
        holds = 0.0 < self.hfov_deg < 180.0
        require(self, "hfov_deg", holds, "must lie between 0 and 180 degrees. A fisheye camera sees more")
        super().__post_init__()

    @property
    def has_image_plane(self) -> bool:
        """A lens projects points onto an image."""
        return True


@dataclass(frozen=True, kw_only=True)
class StereoCfg(CameraCfg):
    """Two pinhole cameras side by side with equal attitude; images are those of the first.

    A pixel is valid only if the second camera sees the same point, unobstructed; otherwise it holds ``near_pixel``.
    """

    model: str = "stereo"  # Name of this model in a file
    baseline: float  # Second camera from the first, which is mounted, along y [m], left positive; not 0

    def __post_init__(self) -> None:
        require(self, "baseline", 0.0 < abs(self.baseline) < inf, "must be finite and not 0. Left is positive")
        super().__post_init__()

    @property
    def has_second_camera(self) -> bool:
        """The second image is shifted by the disparity."""
        return True


@dataclass(frozen=True, kw_only=True)
class FisheyeCfg(RangeSensorCfg):
    """An equidistant fisheye camera: a ray at the angle theta from the axis is seen ``r = f theta`` from the middle.

    Every pixel of the rectangle has a ray; corners lie further off the axis than the edges do.
    """

    model: str = "fisheye"  # Name of this model in a file

    hfov_deg: float
    """Horizontal field of view, from left edge to right edge [deg], 0 < hfov <= 360. The vertical and the diagonal one
    follow in proportion to the pixels; the corner pixels must look less than 180 degrees off the axis."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self, "hfov_deg", 0.0 < self.hfov_deg <= 360.0, "must be > 0 and at most 360 degrees")
        corner = 0.5 * hypot(self.width - 1, self.height - 1) / self.width * self.hfov_deg
        rule = f"a corner pixel looks {corner:.1f} degrees off the axis: must be less than 180. Give a smaller field of view"
        require(self, "hfov_deg", corner < 180.0, rule)

    @property
    def has_image_plane(self) -> bool:
        """A lens projects points onto an image."""
        return True


MOST_MISALIGNMENT_DEG = 45.0  # Largest misalignment; use `euler` for larger rotations of the axes


@dataclass(frozen=True, kw_only=True)
class ImuCfg(PlacementCfg):
    """Three accelerometers and three gyros at one point of the body."""

    model: str = "imu"  # Name of this model in a sensor file; an IMU's own file may leave it out
    summary: str  # One line for people who choose a sensor

    misalignment_deg: Vec3 = (0.0, 0.0, 0.0)
    """Each reset turns the IMU further, about its own axes (ZYX), by roll, pitch, yaw drawn uniformly within +- these [deg],
    0 to 45."""

    accel_noise_density: Vec3  # White noise of each accelerometer [m/s²/sqrt(Hz)], >= 0
    gyro_noise_density: Vec3  # White noise of each gyro [rad/s/sqrt(Hz)], >= 0
    accel_bias_walk: Vec3  # Random walk of each accelerometer's bias [m/s²/sqrt(s)], >= 0
    gyro_bias_walk: Vec3  # Random walk of each gyro's bias [rad/s/sqrt(s)], >= 0
    accel_initial_bias: Vec3  # Each reset draws the bias of each accelerometer uniformly within +- these [m/s²], >= 0
    gyro_initial_bias: Vec3  # Each reset draws the bias of each gyro uniformly within +- these [rad/s], >= 0
    accel_range: float  # Accelerometers saturate at +- this [m/s²], > 0
    gyro_range: float  # Gyros saturate at +- this [rad/s], > 0

    rate_hz: float | None = None
    """Measurements per second of simulated time [Hz], > 0 and at most one per environment step, between which the last one
    stays; each is the mean over its own period. None: one at every step."""

    latency_s: float = 0.0  # Age of a measurement when it appears [s], >= 0, rounded to whole environment steps
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        require_choice(self, "model", ("imu",))
        require_positive(self, "rate_hz", "accel_range", "gyro_range")
        self.check_placement()
        errors = ("noise_density", "bias_walk", "initial_bias")
        require_not_negative(self, "latency_s", *(f"{kind}_{name}" for kind in ("accel", "gyro") for name in errors))
        holds = all(0.0 <= angle <= MOST_MISALIGNMENT_DEG for angle in self.misalignment_deg)
        require(self, "misalignment_deg", holds, f"must lie within 0 and {MOST_MISALIGNMENT_DEG:g} degrees")


def load_imu(path: str | Path) -> ImuCfg:
    """Return the IMU in a YAML file; those that come with the package are registered in ``aerial_gym.sensors.IMUS``."""
    return load(ImuCfg, path)


__all__ = [
    "FRAMES", "KINDS", "MODELS", "CameraCfg", "FisheyeCfg", "LidarCfg", "LightCfg", "NoiseCfg", "PrismCfg",
    "RangeSensorCfg", "RayTableCfg", "RosetteCfg", "ScannedCfg", "SensorCfg", "StereoCfg", "load_any_sensor",
    "load_sensor",
]  # fmt: skip

MODELS: dict[str, type[RangeSensorCfg]] = {
    "pinhole": CameraCfg, "stereo": StereoCfg, "fisheye": FisheyeCfg, "lidar": LidarCfg, "ray_table": RayTableCfg,
    "rosette": RosetteCfg,
}  # fmt: skip
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
