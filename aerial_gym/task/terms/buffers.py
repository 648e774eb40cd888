"""Task buffers: values of the previous step, declared like GTD keys and made when a term reads them.

A buffer is a pure function like a term, computed for all environments after every step and its resets, and read by terms of
the next step. It may read itself, and ``begun``, the mask of episodes that have just begun.
Letters: E environments, U entries of an action.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.registry import Registry
from aerial_gym.task.terms.gate_path import gate_path_length
from aerial_gym.task.terms.term import Function, Term


@dataclass(frozen=True, kw_only=True)
class Buffer:
    """Declaration of a buffer and its update after a step."""

    term: Term
    shape: tuple[int | str, ...]  # Of a row
    unit: str
    frame: str

    @property
    def summary(self) -> str:
        """One line about it."""
        return self.term.summary


class BufferRegistry(Registry[Buffer]):
    """Buffers by name."""

    def buffer(
        self, name: str | None = None, *, shape: tuple[int | str, ...] = (), unit: str = "-", frame: str = "-"
    ) -> Callable[[Function], Function]:
        """Register the function below as the update of a floating-point buffer after a step.

        Args:
            name: Under which terms read it; that of the function if not given.
            shape: Of a row; () for one number, letters such as ``U`` and ``R`` as in the GTD.
            frame: ``world``, ``body``, ``vehicle`` or ``-``.
        """

        def add(function: Function) -> Function:
            known = name or function.__name__
            term = Term(name=known, value=function)
            _ = term.reads
            self.register(known, Buffer(term=term, shape=shape, unit=unit, frame=frame))
            return function

        return add


BUFFERS = BufferRegistry("task buffer")  # Buffers by the name under which terms read them


STEP_TIME = "step_time"  # Buffer of the time of a step [s], one number


@BUFFERS.buffer(unit="m")
def previous_distance(target_position: Tensor, robot_position: Tensor) -> Tensor:
    """Return the distance to the target one step before, or at the reset, (E,)."""
    return (target_position - robot_position).norm(dim=-1)


@BUFFERS.buffer(unit="m")
def previous_clearance(robot_clearance: Tensor) -> Tensor:
    """Return the clearance of the previous step, or at the reset [m], (E,)."""
    return robot_clearance.clone()


@BUFFERS.buffer(shape=(3,), unit="m", frame="world")
def previous_position(robot_position: Tensor) -> Tensor:
    """Return the position one step before, or at the reset, (E, 3)."""
    return robot_position.clone()


@BUFFERS.buffer(shape=(3,), unit="m/s", frame="world")
def previous_relative_velocity(robot_linvel: Tensor, target_velocity: Tensor) -> Tensor:
    """Return the velocity relative to the target one step before, or at the reset, (E, 3)."""
    return robot_linvel - target_velocity


@BUFFERS.buffer(shape=("V",))
def policy_action(policy_action: Tensor, begun: Tensor) -> Tensor:
    """Return the policy's last action, before transform, delay and filter; 0 at the start of an episode, (E, V)."""
    return torch.where(begun.unsqueeze(-1), 0.0, policy_action)


@BUFFERS.buffer(unit="m")
def previous_way(target_position: Tensor, target_orientation: Tensor, robot_position: Tensor) -> Tensor:
    """Return the way to the next gate of a track one step before, or at the reset, (E,): see ``way.gate_path_length``."""
    return gate_path_length(target_position, target_orientation, robot_position)
