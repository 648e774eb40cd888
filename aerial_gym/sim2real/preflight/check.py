"""The preflight check: sensors, rotors and link of a log against a robot file and the training of a policy."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.storage import write_atomic
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.rotors import check_rotor_columns
from aerial_gym.sim2real.logs.flights import (
    derive_velocity,
    resample_log,
    scale_commands_to_hover_thrust,
    scale_relative_commands,
)
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.mapping import LogMapping
from aerial_gym.sim2real.preflight.constants import Constant
from aerial_gym.sim2real.preflight.link import check_link
from aerial_gym.sim2real.preflight.noise import sensor_noise
from aerial_gym.sim2real.preflight.ranges import TrainingConditions, findings_outside_training
from aerial_gym.sim2real.preflight.result_file import digest
from aerial_gym.sim2real.preflight.rotors import check_rotors
from aerial_gym.sim2real.preflight.sensors import check_sensors
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.wording import finding_rows

CONTRADICTIONS = ("constant_contradicted", "gyro_sign_contradicted", "rotor_order_contradicted", "spins_contradicted")


@dataclass(frozen=True, kw_only=True)
class Preflight:
    """Result of a preflight check."""

    robot: str
    log: str
    policy: str = ""  # Whose training the log is compared with
    findings: tuple[
        Finding, ...
    ]  # One for each constant, sign and order, the contradictions first; then what is outside
    constants: tuple[Constant, ...] = field(default=(), repr=False)
    noise: Mapping[str, float] = field(default_factory=dict)  # Standard deviations of the sensors, by stream

    @property
    def contradictions(self) -> tuple[Finding, ...]:
        """Contradictions of the file."""
        return tuple(one for one in self.findings if one.code in CONTRADICTIONS)

    @property
    def verdict(self) -> str:
        """``contradicted``, or ``ready``."""
        return "contradicted" if self.contradictions else "ready"

    def as_mapping(self) -> dict[str, object]:
        """Return the result for JSON."""
        names: dict[str, object] = {
            "verdict": self.verdict,
            "robot": self.robot,
            "log": self.log,
            "policy": self.policy,
        }
        return names | {"noise": dict(self.noise), "findings": finding_rows(self.findings)}

    def write(self, path: Path) -> None:
        """Write the result as JSON, with its hash."""
        content = self.as_mapping()
        write_atomic(path, json.dumps(content | {"sha256": digest(content)}, indent=1, ensure_ascii=False) + "\n")


def preflight(
    robot: str | Path | RobotCfg,
    log: str | Path,
    *,
    training: TrainingConditions | None = None,
    mapping: LogMapping | None = None,
    progress: Progress = silent,
) -> Preflight:
    """Return the comparison of a log with a robot file.

    Args:
        robot: Robot of the policy's training.
        log: Flight or flights of the real vehicle: hover, climbs, a yaw turn, steps of the body rates.
        training: Link and motion of the training; the rate of commands is not judged without.
        mapping: Layout of a CSV file.

    Raises:
        ConfigError: If the policy was trained on another robot.
        DataError: If the log has no gyro, accelerometer or rotors, or too little of a flight.
    """
    cfg = robot if isinstance(robot, RobotCfg) else robot_by_name(robot)
    if "force" in cfg.rotor_traits:
        raise ConfigError("preflight compares rotor speeds: give a robot file with rotors in speed mode")
    conditions = training or TrainingConditions()
    conditions.check_robot(cfg)
    progress("reading the log", 0.0)
    logs = read_flights([log], mapping=mapping)
    for one in logs:
        if one.ang_vel is None or one.specific_force is None:
            raise DataError(f"{one.path}: preflight needs gyro and accelerometer; log them, or map their columns")
    logs = [scale_relative_commands(derive_velocity(resample_log(one)), cfg) for one in logs]
    logs = [scale_commands_to_hover_thrust(one, cfg) for one in logs]
    for one in logs:
        check_rotor_columns(one, cfg)
    progress("sensors", 0.3)
    sensors = check_sensors(logs)
    progress("rotors", 0.6)
    rotors = check_rotors(sensors.logs, cfg)
    progress("link", 0.9)
    link = check_link(sensors.logs, rotors.robot, conditions.link)
    constants = (*sensors.constants, *rotors.constants, *link)
    findings = [*sensors.findings, *rotors.findings, *(one.finding() for one in constants)]
    name = "" if isinstance(robot, RobotCfg) else str(robot)
    outside = findings_outside_training(sensors.logs, conditions)
    return Preflight(
        robot=name,
        log=str(log),
        policy=conditions.source,
        findings=(*_in_order(findings), *outside),
        constants=constants,
        noise=sensor_noise(logs),
    )


def _in_order(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings with contradictions first, then measured values, then assumed ones."""
    ends = ("contradicted", "measured", "assumed")
    return tuple(sorted(findings, key=lambda one: ends.index(one.code.rpartition("_")[2])))
