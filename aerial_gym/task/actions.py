"""Actions: pure functions from what a policy gives, each entry -1 to 1, to what the controller takes.

Letters: E environments, U entries of an action or command.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.control.laws import LAWS


def direct(actions: Tensor, params: Mapping[str, float]) -> Tensor:
    """Return the action itself, (E, U)."""
    del params
    return actions


def forward_flight(actions: Tensor, params: Mapping[str, float]) -> Tensor:
    """Return a velocity that never points sideways or backwards, and a yaw rate: the camera sees where the robot flies.

    Args:
        actions: Speed, inclination of the velocity, yaw rate, and an entry that is not used; clamped to -1..1, (E, 4).
        params: ``max_speed`` [m/s], ``max_inclination`` [rad], ``max_yaw_rate`` [rad/s].

    Returns:
        Velocity ``(s cos i, 0, s sin i)`` [m/s], vehicle frame, with ``s`` from 0 to the largest speed, and yaw rate
        [rad/s], (E, 4).

    Source:
        Aerial Gym Simulator 2.0.1, navigation_task.
    """
    speed, inclination, yaw_rate, _ = actions.clamp(-1.0, 1.0).unbind(-1)
    speed, inclination = 0.5 * params["max_speed"] * (speed + 1.0), params["max_inclination"] * inclination
    forward, up = speed * torch.cos(inclination), speed * torch.sin(inclination)
    return torch.stack((forward, torch.zeros_like(forward), up, params["max_yaw_rate"] * yaw_rate), dim=-1)


@dataclass(frozen=True, kw_only=True)
class Action:
    """How actions become commands."""

    value: Callable[[Tensor, Mapping[str, float]], Tensor]
    """Actions (E, U) and numbers to commands."""

    params: tuple[str, ...] = ()
    """Names of its numbers."""

    width: int | None = None
    """Entries of an action; None is the width of the command."""

    command: tuple[str, ...] | None = None
    """What the controller must take; None fits all."""


ACTIONS: dict[str, Action] = {
    "direct": Action(value=direct),
    "forward_flight": Action(
        value=forward_flight,
        params=("max_speed", "max_inclination", "max_yaw_rate"),
        width=4,
        command=LAWS["velocity"].action,
    ),
}
"""Actions by the name that a task configuration uses."""
