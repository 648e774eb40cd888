"""Placement of a sensor on the body, constant or drawn, and its mount on a robot: sensor, pose, name and rate.

Frames: body is x forward, y left, z up; a sensor looks along its own x, an IMU's axes are the body's where it is not turned.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from aerial_gym.config import checks
from aerial_gym.config.checks import Vec3, require_angles, require_finite, require_ordered
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class PlacementCfg:
    """Nominal placement of a sensor, and the range of its draws at reset."""

    position: Vec3 = (0.0, 0.0, 0.0)  # Nominal place of rays or accelerometers from the body origin [m], body axes
    euler: Vec3 = (0.0, 0.0, 0.0)  # Nominal ZYX roll, pitch, yaw from body to sensor [rad], within +-2 pi
    position_low: Vec3 | None = None  # Lowest drawn position at a reset [m], body axes; None keeps `position`
    position_high: Vec3 | None = None  # Highest one; given with `position_low`, and `position` lies between them
    euler_low: Vec3 | None = None  # Lowest drawn Euler angles at a reset [rad]; None keeps `euler`
    euler_high: Vec3 | None = None  # Highest ones; given with `euler_low`, and `euler` lies between them

    def check_placement(self) -> None:
        """Raise ``ConfigError`` unless the numbers are finite and each nominal one lies between its ends."""
        require_finite(self, "position", "position_low", "position_high")
        require_angles(self, "euler", "euler_low", "euler_high")
        for name in ("position", "euler"):
            low, high = f"{name}_low", f"{name}_high"
            given = [each for each in (low, high) if getattr(self, each) is not None]
            if len(given) == 1:
                raise ConfigError(f"{type(self).__name__}: give both {low} and {high}, or neither")
            if given:
                require_ordered(self, low, name)
                require_ordered(self, name, high)


Quat = tuple[float, float, float, float]

BODY = "body"  # Default carrier of sensors; the name of a joint stands for its link


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

    sensor: str  # Registered sensor or IMU, or the path of its YAML file, relative to the robot's own file

    name: str | None = None
    """Its own name on this robot, in ``snake_case``; that of the sensor, or of its file, if not given. It stands in front of
    the GTD keys of every range sensor but the first and of every IMU but the first."""

    parent: str = BODY
    """Carrier: ``body``, or the joint whose link carries it. The pose is relative to its frame; that of a
    link is the body's in the reference pose, so that the place of a sensor on an arm counts from the body origin."""

    position: Vec3 | None = None  # Of the sensor in its parent's frame [m]
    euler: Vec3 | None = None  # ZYX roll, pitch, yaw from parent to sensor [rad], within +-2 pi; or `quaternion`
    quaternion: Quat | None = None  # Attitude of the sensor, sensor to parent, xyzw; made unit length
    rate_hz: float | None = None  # Measurements per second of simulated time [Hz], > 0; the sensor's own if not given
    latency_s: float | None = None  # Age of a measurement when it appears [s], >= 0; the sensor's own if not given

    @property
    def link(self) -> str:
        """Name of the link that carries it."""
        return BASE if self.parent == BODY else self.parent

    @property
    def key(self) -> str:
        """Its name on the robot."""
        return self.name or Path(self.sensor).stem

    def __post_init__(self) -> None:
        is_name = re.fullmatch(r"[a-z][a-z0-9_]*", self.key) is not None
        checks.require(self, "key", is_name, "must be snake_case. Give the mount a name of its own")
        try:
            checks.require_finite(self, "position", "quaternion")
            checks.require_angles(self, "euler")
            checks.require(self, "euler", self.euler is None or self.quaternion is None, "give it or quaternion")
            holds = self.quaternion is None or sum(q * q for q in self.quaternion) >= 1e-12
            checks.require(self, "quaternion", holds, "must not be zero")
            checks.require_positive(self, "rate_hz")
            checks.require_not_negative(self, "latency_s")
        except ConfigError as error:
            raise ConfigError(f"mount of {self.sensor!r}: {error}") from None


def as_mounts(sensors: tuple[str | SensorMountCfg, ...]) -> tuple[SensorMountCfg, ...]:
    """Return mounts, with a plain name as one in the sensor's own place; raise ``ConfigError`` if two have one name."""
    mounts = tuple(SensorMountCfg(sensor=given) if isinstance(given, str) else given for given in sensors)
    keys = [mount.key for mount in mounts]
    for mount in mounts:
        if keys.count(mount.key) > 1:
            remedy = f"Give one a name of its own: {{sensor: {mount.sensor}, name: ...}}"
            raise ConfigError(f"RobotCfg.sensors: two mounts are named {mount.key!r}. {remedy}")
    return mounts
