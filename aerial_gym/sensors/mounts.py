"""Sensors with their poses from the mounts of a robot file, looked up by name or file.

Frames: body is x forward, y left, z up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import torch
from torch import Tensor

from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.config.sensor import ImuCfg, RangeSensorCfg, SensorCfg, load_any_sensor
from aerial_gym.config.sensor_mount import SensorMountCfg, is_file
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError, suggest_name
from aerial_gym.math.quaternion import quat_conjugate, quat_from_euler, quat_multiply, quat_normalize, quat_rotate
from aerial_gym.registry import Registry
from aerial_gym.sensors.catalog import IMUS, SENSORS

Cfg = TypeVar("Cfg", RangeSensorCfg, ImuCfg)

PLACE = ("position", "euler")  # Components of a sensor's placement that can be random


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A place in the body frame, float64."""

    position: Tensor  # [m], (3,)
    attitude: Tensor  # To the body, xyzw, unit, (4,)

    def transform(self, position: Tensor, attitude: Tensor) -> tuple[Tensor, Tensor]:
        """Return position (..., 3) and attitude (..., 4) of this frame in the body frame."""
        turn = self.attitude.to(attitude).expand_as(attitude)
        return self.position.to(position) + quat_rotate(turn, position), quat_multiply(turn, attitude)

    def inverse(self) -> "Pose":
        """Return the pose of the body in this frame."""
        back = quat_conjugate(self.attitude)
        return Pose(position=-quat_rotate(back, self.position), attitude=back)


@dataclass(frozen=True, kw_only=True)
class Carrier:
    """Motion of the body or link that carries a sensor: tensors read at every measurement, strided or not."""

    number: int = 0  # Of the link; 0 of the body
    position: Tensor  # Origin of its frame [m], world, (E, 3)
    attitude: Tensor  # To the world, xyzw, unit, (E, 4)
    lin_vel: Tensor | None = None  # Of the origin [m/s], world, (E, 3); not for sensors without motion, as the next
    ang_vel: Tensor | None = None  # [rad/s], its own axes, (E, 3)


@dataclass(frozen=True, kw_only=True)
class OwnLinks:
    """Links of the vehicles that carry sensors, among those of all vehicles of a scene."""

    first: int = 0  # Of the first such vehicle of an environment
    count: int = 1  # Of one vehicle
    seen: bool = True  # Whether the sensors of a vehicle see it


@dataclass(frozen=True, kw_only=True)
class RobotSensor(Generic[Cfg]):
    """A sensor on a robot."""

    cfg: Cfg  # The sensor, with the rate and latency of its mount
    pose: Pose | None  # Pose of the mount in place of the nominal one; None without
    link: str = BASE  # Name of the link that carries it


def sensor_by_name(name: str) -> SensorCfg:
    """Return a registered range sensor or IMU, or the one in a ``.yaml`` file; raise ``UnknownNameError`` without one."""
    if is_file(name):
        return load_any_sensor(name)
    if name in IMUS:
        return IMUS.get(name)
    if name in SENSORS:
        return SENSORS.get(name)
    known: Registry[SensorCfg] = Registry("sensor")
    for registry in (SENSORS, IMUS):
        for each in registry:
            known.register(each, registry.get(each))
    return known.get(name)


def file_pose(cfg: SensorCfg) -> Pose:
    """Return the placement in the sensor's own file."""
    attitude = quat_from_euler(torch.tensor(cfg.euler, dtype=torch.float64))
    return Pose(position=torch.tensor(cfg.position, dtype=torch.float64), attitude=attitude)


def mount_pose(mount: SensorMountCfg, cfg: SensorCfg) -> Pose | None:
    """Return the pose of a mount, completed from the sensor's file; None for a mount without a pose."""
    if mount.position is None and mount.euler is None and mount.quaternion is None:
        return None
    pose = file_pose(cfg)
    if mount.position is not None:
        pose = replace(pose, position=torch.tensor(mount.position, dtype=torch.float64))
    if mount.euler is not None:
        pose = replace(pose, attitude=quat_from_euler(torch.tensor(mount.euler, dtype=torch.float64)))
    if mount.quaternion is not None:
        pose = replace(pose, attitude=quat_normalize(torch.tensor(mount.quaternion, dtype=torch.float64)))
    return pose


def _with_drawn_placement(cfg: Cfg, drawn: Mapping[str, RandomizeCfg]) -> Cfg:
    """Return a sensor with uniform offsets of ``position`` [m] and ``euler`` [rad], in the frame of its own file."""
    ends = {}
    for field, each in drawn.items():
        nominal = getattr(cfg, field)
        for k, end in enumerate(("low", "high")):
            ends[f"{field}_{end}"] = tuple(
                n + x[k] for n, x in zip(nominal, each.component_distributions(3), strict=True)
            )
    return replace(cfg, **ends)


def _check_placement_draws(places: Randomize, mounts: Sequence[SensorMountCfg]) -> None:
    known = [f"sensors.{mount.key}.{field}" for mount in mounts for field in PLACE]
    for name, each in places.items():
        if name not in known:
            raise ConfigError(
                f"randomize: no quantity {name!r}.{suggest_name(name, known)} Known: {', '.join(known) or 'no sensor'}"
            )
        if each.how != "offset" or each.distribution != "uniform":
            raise ConfigError(f"randomize: {name}: places of sensors take uniform offsets (how: offset)")


def mounted_sensors(
    mounts: Sequence[SensorMountCfg], places: Randomize | None = None
) -> tuple[dict[str, RobotSensor[RangeSensorCfg]], dict[str, RobotSensor[ImuCfg]]]:
    """Return the range sensors and the IMUs of a robot by the names of their mounts, in order.

    Args:
        places: Random offsets of placements, by ``sensors.NAME.position`` [m] and ``sensors.NAME.euler`` [rad].
    """
    places = places or {}
    _check_placement_draws(places, mounts)
    ranges: dict[str, RobotSensor[RangeSensorCfg]] = {}
    imus: dict[str, RobotSensor[ImuCfg]] = {}
    for mount in mounts:
        cfg = sensor_by_name(mount.sensor)
        timing = {name: getattr(mount, name) for name in ("rate_hz", "latency_s") if getattr(mount, name) is not None}
        pose = mount_pose(mount, cfg)
        drawn = {field: places[name] for field in PLACE if (name := f"sensors.{mount.key}.{field}") in places}
        cfg = _with_drawn_placement(replace(cfg, **timing), drawn)
        if isinstance(cfg, ImuCfg):
            imus[mount.key] = RobotSensor(cfg=cfg, pose=pose, link=mount.link)
        else:
            ranges[mount.key] = RobotSensor(cfg=cfg, pose=pose, link=mount.link)
    return ranges, imus
