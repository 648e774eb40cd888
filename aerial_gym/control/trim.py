"""The axes that a control law controls at hover, and its action there, for the checks before flight.

The package's own laws state their axes in ``control.laws``. A law of another package states them in the class attribute
``trim``, and its action at hover, unless that is zeros, in ``hover_action``.
Letters: U entries of an action.
"""

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control.catalog import CONTROL_LAWS
from aerial_gym.control.controllers import Controller
from aerial_gym.control.laws import LAWS
from aerial_gym.control.linear_loop import AXES
from aerial_gym.errors import ConfigError

HEIGHT_ENTRY = "z [m]"  # Name of the entry of an action that is a height


def trim_axes(controller: ControllerCfg) -> tuple[str, ...] | None:
    """Return the ``AXES`` that a law controls; None for a law of another package that does not state them.

    Raises:
        ConfigError: If a name is unknown.
    """
    if controller.law in LAWS:
        return tuple(LAWS[controller.law].trim.split())
    if controller.law not in CONTROL_LAWS:
        return ()
    entry = CONTROL_LAWS.get(controller.law)
    trim = getattr(getattr(entry, "func", entry), "trim", None)  # a functools.partial has the class in func
    if trim is None:
        return None
    if unknown := set(trim.split()) - set(AXES):
        raise ConfigError(
            f"law {controller.law!r}: trim = {trim!r}: {min(unknown)!r} is no axis. Known: {' '.join(AXES)}"
        )
    return tuple(trim.split())


def hover_action(law: Controller, height: float) -> Tensor:
    """Return the action at hover at a height [m], float64, (U,): ``law.hover_action``, else zeros, with the height."""
    given = getattr(law, "hover_action", ()) or [0.0] * len(law.action_names)
    entries = [height if name == HEIGHT_ENTRY else x for name, x in zip(law.action_names, given, strict=True)]
    return torch.tensor(entries, dtype=torch.float64)
