"""Motion in a log outside the range of a policy's training."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.preflight.link import TrainingLink

MATERIAL = 0.001  # Least share of the time outside that is reported: single samples of noise


@dataclass(frozen=True, kw_only=True)
class TrainingConditions:
    """Link and motion of the flights of a policy in its training's task."""

    link: TrainingLink = field(default_factory=TrainingLink)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # By the names of ``motion_of_log``
    source: str = ""  # The policy
    robot: RobotCfg | None = None  # Robot of the training; None: not known

    def check_robot(self, robot: RobotCfg) -> None:
        """Raise ``ConfigError`` if the policy was trained on a robot with other dynamics."""
        if self.robot is None:
            return
        pairs = zip(*(_dynamics(one).items() for one in (self.robot, robot)), strict=True)
        parts = [name for (name, trained), (_, given) in pairs if trained != given]
        if parts:
            raise ConfigError(
                f"policy {self.source}: was trained on a robot with other {', '.join(parts)} ({self.robot.summary}). Give the "
                "robot file of its training, or train a policy on this one (train --robot FILE)"
            )


def _dynamics(robot: RobotCfg) -> dict[str, object]:
    """Return the parts of a robot that a log is compared with, without their sources."""
    parts = {"mass or inertia": robot.body, "battery": robot.battery}
    plain: dict[str, object] = {name: part and replace(part, source="") for name, part in parts.items()}
    plain["rotors"] = [replace(one, source="") for one in robot.rotor_types]
    return plain | {"mounts": robot.mounts.layout, "effects": robot.effects}


def motion_of_log(log: FlightLog) -> dict[str, Array]:
    """Return observed and commanded quantities of a log by their names with units, each (T,) or (K,)."""
    turn = Rotation.from_quat(log.attitude)
    yaw, pitch, roll = turn.as_euler("ZYX").T
    del yaw
    motion = {"roll [rad]": roll, "pitch [rad]": pitch}
    if log.lin_vel is not None:
        motion |= _columns_by_name(
            "velocity {} [m/s]", ("forward", "left", "up"), turn.apply(log.lin_vel, inverse=True)
        )
    if log.ang_vel is not None:
        motion |= _columns_by_name("{} rate [rad/s]", ("roll", "pitch", "yaw"), log.ang_vel)
    if "rate_setpoint" in log.setpoints:
        motion |= _columns_by_name(
            "commanded {} rate [rad/s]", ("roll", "pitch", "yaw"), log.setpoints["rate_setpoint"][1]
        )
    if log.rotor_speed is not None:
        motion["rotor speed [rad/s]"] = log.rotor_speed.ravel()
    return motion


def _columns_by_name(pattern: str, names: Sequence[str], values: Array) -> dict[str, Array]:
    return {pattern.format(name): column for name, column in zip(names, values.T, strict=True)}


def findings_outside_training(logs: Sequence[FlightLog], training: TrainingConditions) -> list[Finding]:
    """Return a finding on each quantity that is outside the range of the training for more than ``MATERIAL`` of the time."""
    motions, findings = [motion_of_log(log) for log in logs], list[Finding]()
    for name, (low, high) in training.ranges.items():
        known = [motion[name] for motion in motions if name in motion]
        if not known:
            continue
        values = np.concatenate(known)
        share = float(np.mean((values < low) | (values > high)))
        if share > MATERIAL:
            ends = {"low": float(values.min()), "high": float(values.max()), "trained_low": low, "trained_high": high}
            findings.append(Finding("outside_training", name, ends | {"share": share}))
    return sorted(findings, key=lambda one: -float(one.values["share"]))
