"""Robots: their configurations and the manager that flies them."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.robots.catalog import ROBOTS
    from aerial_gym.robots.contact_sources import Surroundings
    from aerial_gym.robots.robot_manager import RobotManager

__all__ = ["ROBOTS", "RobotManager", "Surroundings"]

__getattr__, __dir__ = exports(__name__, __file__)
