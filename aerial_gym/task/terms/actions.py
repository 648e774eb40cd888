"""Action transforms: pure functions from policy outputs, each -1 to 1, to controller commands.

Letters: E environments, U entries of an action or command.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.control.laws import LAWS
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.task.terms.term import Function


@dataclass(frozen=True, kw_only=True)
class Action:
    """A registered action transform."""

    value: Callable[..., Tensor]  # Of actions (E, U) and parameters by name, to commands
    width: int | None = None  # Entries of an action; None is the width of the command
    command: tuple[str, ...] | None = None  # Required controller command; None fits all

    @property
    def summary(self) -> str:
        """One line about it."""
        return (self.value.__doc__ or "").partition("\n")[0]


class ActionRegistry(Registry[Action]):
    """Transforms by name."""

    def transform(
        self, name: str | None = None, *, width: int | None = None, command: Sequence[str] | None = None
    ) -> Callable[[Function], Function]:
        """Register the function below, ``(actions, *, parameters)``, under its own name or another one.

        Args:
            name: Under which a task asks for it; that of the function if not given.
            width: Entries of an action; those of the command if not given.
            command: Required controller command; None fits all.
        """

        def add(function: Function) -> Function:
            needs = None if command is None else tuple(command)
            self.register(name or function.__name__, Action(value=function, width=width, command=needs))
            return function

        return add


ACTIONS = ActionRegistry("action")  # Transforms by the name that a task configuration uses
ROTOR_RANGE = "rotor_range"  # An `affine`, or `four_places`, with the numbers of the robot's rotors
NEGLIGIBLE = 1e-12  # Share of a thrust below which a root has no gradient of use


@ACTIONS.transform()
def direct(actions: Tensor) -> Tensor:
    """Return the action itself, (E, U)."""
    return actions


@ACTIONS.transform(width=4, command=LAWS["velocity"].action)
def forward_flight(actions: Tensor, *, max_speed: float, max_inclination: float, max_yaw_rate: float) -> Tensor:
    """Return a velocity that never points sideways or backwards, and a yaw rate: the camera sees where the robot flies.

    Actions (E, 4), clamped to -1..1: speed, inclination of the velocity, yaw rate, and one that is not used
    (``forward_flight_3`` has none). Returns ``(s cos i, 0, s sin i)`` [m/s], vehicle frame, with ``s`` from 0 to
    ``max_speed`` and i up to ``max_inclination`` [rad], and a yaw rate [rad/s], (E, 4).

    Source:
        Aerial Gym Simulator 2.0.1, navigation_task.
    """
    speed, inclination, yaw_rate = actions.clamp(-1.0, 1.0).unbind(-1)[:3]
    speed, inclination = 0.5 * max_speed * (speed + 1.0), max_inclination * inclination
    forward, up = speed * torch.cos(inclination), speed * torch.sin(inclination)
    return torch.stack((forward, torch.zeros_like(forward), up, max_yaw_rate * yaw_rate), dim=-1)


@ACTIONS.transform()
def affine(
    actions: Tensor, *, low: tuple[float, ...], high: tuple[float, ...], order: tuple[int, ...] | None = None
) -> Tensor:
    """Return the action, clamped to -1..1 and stretched so that -1 is ``low`` and 1 is ``high``, entry by entry, (E, U).

    With an ``order`` an entry of the command is the entry of the action that has this number.
    """
    clamped = actions.clamp(-1.0, 1.0).unbind(-1)
    if order is not None:
        clamped = [clamped[number] for number in order]
    stretched = [0.5 * (b - a) * (u + 1.0) + a for u, a, b in zip(clamped, low, high, strict=True)]
    return torch.stack(stretched, dim=-1)


@ACTIONS.transform(width=4)
def four_places(
    actions: Tensor, *, mix: tuple[tuple[float, ...], ...], low: tuple[float, ...], high: tuple[float, ...],
    speeds: tuple[bool, ...],
) -> Tensor:  # fmt: skip
    """Return commands (E, U) of any rotor layout from four quadrotor commands, by lift and torque.

    Args:
        actions: Speeds of the four, clamped to -1..1: none, and the highest, (E, 4).
        mix: Thrust shares of U rotors per thrust share of the four, (U, 4).
        low: Lowest speed [rad/s] or thrust [N] of each rotor, negative for one that turns backwards too, (U,).
        high: Highest, (U,).
        speeds: Whether each takes a speed, whose square is proportional to thrust, (U,).
    """
    told = (0.5 * (actions.clamp(-1.0, 1.0) + 1.0)).unbind(-1)
    lifts = [share.square() for share in told]
    commands = []
    for row, lowest, highest, speed in zip(mix, low, high, speeds, strict=True):
        share = sum((weight * lift for weight, lift in zip(row, lifts, strict=True)), torch.zeros_like(lifts[0]))
        size = share.abs().clamp(NEGLIGIBLE, 1.0)
        size = size.sqrt() if speed else size
        if lowest < 0.0:
            commands.append((highest * size * share.sign()).clamp(lowest, highest))
        else:
            commands.append(torch.where(share <= 0.0, lowest, lowest + (highest - lowest) * size))  # NaN stays NaN
    return torch.stack(commands, dim=-1)


ACTIONS.register("forward_flight_3", Action(value=forward_flight, width=3, command=LAWS["velocity"].action))
ACTIONS.register(ROTOR_RANGE, Action(value=affine))  # of which a task fills in the numbers
ACTIONS.accept_plugins(action=instance_converter("aerial_gym.task.terms.actions:Action"))
