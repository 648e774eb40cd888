"""aerial_gym: thousands of multirotors at once, corrected by measured flights.

Importing this package starts no device and compiles no kernel; the names below are loaded when first used.
"""

from typing import TYPE_CHECKING

from aerial_gym.compat.modules import install_finder
from aerial_gym.lazy import ImportPath, call_after_import, exports

if TYPE_CHECKING:
    from aerial_gym.assets import ENVIRONMENTS
    from aerial_gym.cli.functions import check, close_loop, evaluate, play, robustness, train
    from aerial_gym.compat.helpers import AERIAL_GYM_DIRECTORY
    from aerial_gym.control import CONTROLLERS
    from aerial_gym.env_manager import SIMS, EnvManager, SimBuilder
    from aerial_gym.physics import BACKENDS, EFFECTS, ROTOR_MAPS
    from aerial_gym.robots import ROBOTS
    from aerial_gym.sensors import SENSORS
    from aerial_gym.task import Task, task_registry

__version__ = "0.2.0"

__all__ = [
    "AERIAL_GYM_DIRECTORY",
    "BACKENDS",
    "CONTROLLERS",
    "EFFECTS",
    "ENVIRONMENTS",
    "ROBOTS",
    "ROTOR_MAPS",
    "SENSORS",
    "SIMS",
    "EnvManager",
    "SimBuilder",
    "Task",
    "__version__",
    "check",
    "close_loop",
    "evaluate",
    "play",
    "robustness",
    "task_registry",
    "train",
]

__getattr__, __dir__ = exports(__name__, __file__)

install_finder()  # module paths of the Aerial Gym Simulator; nothing of it is imported before a script asks
call_after_import("gymnasium.envs", lambda: ImportPath("aerial_gym.task.gymnasium_ids:register_tasks").load()())
