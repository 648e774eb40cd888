"""Controllers and allocation."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.control.catalog import CONTROL_LAWS, CONTROLLERS
    from aerial_gym.control.controllers import Controller, LeeController, make_controller
    from aerial_gym.control.loop_check import check_closed_loop
    from aerial_gym.control.stateful import StatefulController
    from aerial_gym.control.timing import make_timing

__all__ = [
    "CONTROLLERS", "CONTROL_LAWS", "Controller", "LeeController", "StatefulController", "check_closed_loop",
    "make_controller", "make_timing",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
