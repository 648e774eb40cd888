"""aerial_gym: thousands of multirotors at once, corrected by measured flights.

Importing this package starts no device and compiles no kernel; the names below are loaded when first used.
"""

from importlib import import_module

__version__ = "0.1.0"

_HOMES = {
    "SimBuilder": "aerial_gym.env_manager",
    "EnvManager": "aerial_gym.env_manager",
    "SIMS": "aerial_gym.env_manager",
    "ENVIRONMENTS": "aerial_gym.assets",
    "ROBOTS": "aerial_gym.robots",
    "CONTROLLERS": "aerial_gym.control",
    "SENSORS": "aerial_gym.sensors",
    "EFFECTS": "aerial_gym.physics",
    "BACKENDS": "aerial_gym.physics",
    "Task": "aerial_gym.task",
    "task_registry": "aerial_gym.task",
}

__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> object:
    """Return a public name from the part that defines it."""
    if name not in _HOMES:
        raise AttributeError(f"module 'aerial_gym' has no attribute {name!r}. Known: {', '.join(_HOMES)}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
