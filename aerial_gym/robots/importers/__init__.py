"""Robots from the files of other simulators: URDF, MJCF and SDF."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.robots.importers.robot_import import Imported, RotorHints, import_robot, read_robot

__all__ = ["Imported", "RotorHints", "import_robot", "read_robot"]

__getattr__, __dir__ = exports(__name__, __file__)
