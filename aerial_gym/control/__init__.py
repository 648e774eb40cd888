"""Controllers and allocation."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.control.catalog import CONTROLLERS
    from aerial_gym.control.controllers import Controller, LeeController, make_controller
    from aerial_gym.control.loop_check import check_closed_loop

__all__ = ["CONTROLLERS", "Controller", "LeeController", "check_closed_loop", "make_controller"]

__getattr__, __dir__ = exports(__name__, __file__)
