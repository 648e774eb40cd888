"""Vehicle and robot file of each log: by rules (YAML), else the airframe id of the log, else the folder that holds it."""

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fnmatch import translate
from pathlib import Path, PurePosixPath
from typing import TypeVar

from aerial_gym.config.loader import load
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import AerialGymError, ConfigError
from aerial_gym.robots.catalog import robot_by_name

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class VehicleRule:
    """A rule for the logs whose path and airframe id match; empty patterns match all."""

    glob: str = ""
    """Pattern of the whole path, such as */lab/*.ulg."""

    regex: str = ""
    """Regular expression that is searched in the path; its named groups can be used in `vehicle` and `robot`."""

    airframe: str = ""
    """Regular expression of the whole airframe id."""

    vehicle: str = ""
    """Name of the vehicle: text with {airframe}, {folder} or {GROUP}; if empty, the airframe id, else the folder."""

    robot: str = ""
    """Name of the robot file without .yaml, with the same fields; if empty, it is named after the vehicle or a folder."""

    def __post_init__(self) -> None:
        for name, text in (("regex", self.regex), ("airframe", self.airframe)):
            try:
                re.compile(text)
            except re.error as error:
                raise ConfigError(f"VehicleRule.{name} = {text!r}: no regular expression ({error})") from None
        known = {"airframe", "folder", *re.compile(self.regex).groupindex}
        for name in ("vehicle", "robot"):
            unknown = {*re.findall(r"{(\w*)}", getattr(self, name))} - known
            if unknown:
                listed = ", ".join(sorted(known))
                raise ConfigError(f"VehicleRule.{name}: unknown field {', '.join(sorted(unknown))}. Known: {listed}")

    def fields(self, path: str) -> dict[str, str] | None:
        """Return the named groups of the path, None if it does not match."""
        match = re.search(self.regex, path)
        if match is None or (self.glob and not re.match(translate(self.glob), path)):
            return None
        return {name: text or "" for name, text in match.groupdict().items()}


@dataclass(frozen=True, kw_only=True)
class VehicleRules:
    """Rules of a fleet; the first that matches a log counts."""

    rules: tuple[VehicleRule, ...] = field(default=())
    """Rules in order."""


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """Robots by name, and the rules that assign logs to vehicles and robots."""

    robots: Mapping[str, RobotCfg]
    hashes: Mapping[str, str]
    rules: VehicleRules = field(default_factory=VehicleRules)

    def assign(self, path: str, airframe: str) -> tuple[str, str]:
        """Return the names of a log's vehicle and robot, "" for a robot that has no file."""
        folders = [part for part in PurePosixPath(path.replace("\\", "/")).parent.parts[::-1] if part.strip("/")]
        rule, fields = self._find_rule(path, airframe)
        fields = {"airframe": airframe, "folder": folders[0] if folders else ""} | fields
        vehicle = (rule.vehicle.format_map(fields) if rule.vehicle else airframe) or fields["folder"] or "vehicle"
        if rule.robot:
            name = rule.robot.format_map(fields)
            return vehicle, name if name in self.robots else ""
        if len(self.robots) == 1:
            return vehicle, next(iter(self.robots))
        return vehicle, next((name for name in (vehicle, airframe, *folders) if name in self.robots), "")

    def _find_rule(self, path: str, airframe: str) -> tuple[VehicleRule, dict[str, str]]:
        for rule in self.rules.rules:
            fields = rule.fields(path)
            if fields is not None and re.fullmatch(rule.airframe or ".*", airframe, re.DOTALL):
                return rule, fields
        return VehicleRule(), {}

    def robot_needs_airframe(self, path: str) -> bool:
        """Return whether the robot of a log depends on its airframe id."""
        return self.assign(path, "")[1] != self.assign(path, "\0")[1] or (not self.assign(path, "")[1])


def load_fleet(robots: Path, rules: Path | None) -> Fleet:
    """Return the robots of a file or folder with the rules; raise ``ConfigError`` with every fault."""
    files = sorted(robots.glob("*.yaml")) if robots.is_dir() else [robots] if robots.is_file() else []
    reason = "holds no robot file (.yaml)" if robots.is_dir() else "no such file"
    faults = [] if files else [f"--robots {robots}: {reason}"]
    known = {file.stem: try_read(lambda file=file: robot_by_name(file), faults) for file in files}
    table = VehicleRules() if rules is None else try_read(lambda: load(VehicleRules, rules), faults)
    for rule in table.rules if files and table is not None else ():
        if rule.robot and "{" not in rule.robot and rule.robot not in known:
            faults.append(f"--rules {rules}: no robot {rule.robot!r} in {robots}. Known: {', '.join(known)}")
    if faults or table is None:
        raise ConfigError(*faults)
    loaded = {name: robot for name, robot in known.items() if robot is not None}
    return Fleet(robots=loaded, hashes={name: content_hash(one) for name, one in loaded.items()}, rules=table)


def content_hash(configuration: object) -> str:
    """Return the hash of a configuration, such as a robot with all that its file extends."""
    return hashlib.sha256(repr(configuration).encode()).hexdigest()


def try_read(read: Callable[[], T], faults: list[str]) -> T | None:
    """Return the result of ``read``; None if it fails, with the reason appended to ``faults``."""
    try:
        return read()
    except (AerialGymError, OSError) as error:
        faults.append(str(error))
        return None
