"""Scripts of the Aerial Gym Simulator on this simulator: its module paths, classes, registries and tensor keys.

A thin layer: names are translated, rules stay where they are. A script runs with its ``isaacgym`` imports removed, by hand or
by ``python -m aerial_gym.compat SCRIPT.py``. ``docs/guides/coming_from_aerial_gym.md`` has all names side by side.

``modules``: import paths. ``sim_builder``, ``env_manager``, ``tensors``, ``registries``, ``native_task``:
what scripts call. ``config``: configuration classes. ``math``, ``helpers``: functions that they use.
"""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.compat.env_manager import EnvManager
    from aerial_gym.compat.helpers import AERIAL_GYM_DIRECTORY
    from aerial_gym.compat.native_task import BaseTask
    from aerial_gym.compat.registries import (
        controller_registry,
        env_config_registry,
        robot_registry,
        sim_config_registry,
        task_registry,
    )
    from aerial_gym.compat.sim_builder import SimBuilder

__all__ = [
    "AERIAL_GYM_DIRECTORY", "BaseTask", "EnvManager", "SimBuilder", "controller_registry", "env_config_registry",
    "robot_registry", "sim_config_registry", "task_registry",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
