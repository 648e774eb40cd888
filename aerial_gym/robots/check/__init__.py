"""Check of a robot file before training: physical consistency, hover, control authority and stability."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.robots.check.flights import StableStep, largest_stable_step
    from aerial_gym.robots.check.picture import draw_rotors, rotor_views
    from aerial_gym.robots.check.report import RobotReport, check_robot

__all__ = ["RobotReport", "StableStep", "check_robot", "draw_rotors", "largest_stable_step", "rotor_views"]

__getattr__, __dir__ = exports(__name__, __file__)
