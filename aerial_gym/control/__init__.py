"""Controllers and allocation."""

from aerial_gym.control.catalog import CONTROLLERS
from aerial_gym.control.controllers import Controller, make_controller

__all__ = ["CONTROLLERS", "Controller", "make_controller"]
