"""Mount of a sensor on a robot: sensor, pose, name and rate.

Frames: body is x forward, y left, z up; a sensor looks along its own x, an IMU's axes are the body's where it is not turned.
"""

import re
from dataclasses import dataclass
from math import inf, pi
from pathlib import Path

from aerial_gym.config.checks import Vec3, require_finite
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError

Quat = tuple[float, float, float, float]

BODY = "body"
"""Default carrier of sensors; the name of a joint stands for its link."""


def is_file(name: str) -> bool:
    """Return whether a name is the path of a YAML file instead of a registered name."""
    return name.endswith((".yaml", ".yml"))


@dataclass(frozen=True, kw_only=True)
class SensorMountCfg:
    """One sensor on board: a camera, a lidar, any range sensor, or an inertial measurement unit.

    The pose of the mount takes the place of the nominal one of the sensor's own file; without ``position``, or without an
    attitude, that of the file stays. What a reset draws there deviates from the mount as it deviates from the nominal
    placement there: ``T_body_sensor = T_mount T_nominal^-1 T_drawn``. So a camera that is turned with its mount shakes along
    its own axes, and a mount in the nominal place changes nothing. The misalignment of an IMU turns it further, about
    its own axes.
    """

    sensor: str
    """Registered sensor or IMU, or the path of a sensor's or IMU's YAML file, relative to the robot's own file."""

    name: str | None = None
    """Its own name on this robot, in ``snake_case``; that of the sensor, or of its file, if not given. It stands in front of
    the GTD keys of every range sensor but the first and of every IMU but the first."""

    parent: str = BODY
    """Carrier: ``body``, or the joint whose link carries it. The pose is relative to its frame; that of a
    link is the body's in the reference pose, so that the place of a sensor on an arm counts from the body origin."""

    position: Vec3 | None = None
    """Of the sensor in its parent's frame [m]."""

    euler: Vec3 | None = None
    """ZYX roll, pitch, yaw from parent to sensor [rad], within +-2 pi. At most one of this and ``quaternion``."""

    quaternion: Quat | None = None
    """Attitude of the sensor, sensor to parent, xyzw; made unit length."""

    rate_hz: float | None = None
    """Measurements per second of simulated time [Hz], > 0; the sensor's own if not given."""

    latency_s: float | None = None
    """Age of a measurement when it appears [s], >= 0; the sensor's own if not given."""

    @property
    def link(self) -> str:
        """Name of the link that carries it."""
        return BASE if self.parent == BODY else self.parent

    @property
    def key(self) -> str:
        """Its name on the robot."""
        return self.name or Path(self.sensor).stem

    def __post_init__(self) -> None:
        where = f"SensorMountCfg of {self.sensor!r}"
        if not re.fullmatch(r"[a-z][a-z0-9_]*", self.key):
            raise ConfigError(f"{where}: name = {self.key!r}: must be snake_case. Give the mount a name of its own")
        require_finite(self, *(n for n in ("position", "euler", "quaternion") if getattr(self, n) is not None))
        if self.euler is not None and self.quaternion is not None:
            raise ConfigError(f"{where}: give euler or quaternion, not both")
        if self.euler is not None and any(abs(angle) > 2.0 * pi for angle in self.euler):
            raise ConfigError(f"{where}: euler = {self.euler!r}: must lie within +-2 pi. Angles are in radians")
        if self.quaternion is not None and sum(q * q for q in self.quaternion) < 1e-12:
            raise ConfigError(f"{where}: quaternion = {self.quaternion!r}: must not be zero")
        if self.rate_hz is not None and not 0.0 < self.rate_hz < inf:
            raise ConfigError(f"{where}: rate_hz = {self.rate_hz!r}: must be > 0 and finite")
        if self.latency_s is not None and not 0.0 <= self.latency_s < inf:
            raise ConfigError(f"{where}: latency_s = {self.latency_s!r}: must be >= 0 and finite")


def as_mounts(sensors: tuple[str | SensorMountCfg, ...]) -> tuple[SensorMountCfg, ...]:
    """Return mounts; a plain name is one in the sensor's own place.

    Raises:
        ConfigError: If two have the same name.
    """
    mounts = tuple(SensorMountCfg(sensor=given) if isinstance(given, str) else given for given in sensors)
    seen: set[str] = set()
    for mount in mounts:
        if mount.key in seen:
            raise ConfigError(
                f"RobotCfg.sensors: two mounts are named {mount.key!r}. Give one a name of its own: "
                f"{{sensor: {mount.sensor}, name: ...}}"
            )
        seen.add(mount.key)
    return mounts
