"""Robots: their configurations and the manager that flies them."""

from aerial_gym.robots.catalog import ROBOTS
from aerial_gym.robots.robot_manager import RobotManager

__all__ = ["ROBOTS", "RobotManager"]
