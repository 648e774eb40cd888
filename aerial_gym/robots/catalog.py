"""Every robot that comes with the package: the files of ``config/robots``."""

from pathlib import Path

from aerial_gym.config import family_files, read_summary
from aerial_gym.config.environment import ONE_VEHICLE
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.errors import CapabilityError
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.registry.registry import register_files

ROBOTS: Registry[RobotCfg] = Registry("robot")
register_files(ROBOTS, family_files("robots"), load_robot, summary=read_summary)
ROBOTS.accept_plugins(robot=instance_converter("aerial_gym.config.robot:RobotCfg"))


def robot_by_name(name: str | Path | RobotCfg) -> RobotCfg:
    """Return a registered robot, or the one in a robot file if ``name`` ends in ``.yaml``; configurations pass unchanged.
    Several robots raise ``CapabilityError``."""
    if isinstance(name, RobotCfg):
        return name
    if isinstance(name, (list, tuple, set, dict)):
        raise CapabilityError(f"robot_name = {name!r}: {ONE_VEHICLE}")
    if str(name).endswith((".yaml", ".yml")):
        return load_robot(name)
    return ROBOTS.get(str(name))
