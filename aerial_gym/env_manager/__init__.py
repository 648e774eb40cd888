"""Simulations: built by ``SimBuilder``, run by ``EnvManager``."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.env_manager.catalog import SIMS
    from aerial_gym.env_manager.env_manager import EnvManager
    from aerial_gym.env_manager.sim_builder import SimBuilder
    from aerial_gym.robots.catalog import robot_by_name

__all__ = ["SIMS", "EnvManager", "SimBuilder", "robot_by_name"]

__getattr__, __dir__ = exports(__name__, __file__)
