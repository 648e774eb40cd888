"""Terms of observations: pure functions of the states of one instant.

Letters: E environments.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class TaskState:
    """What observations, rewards and terminations may look at; all of one instant."""

    target: Tensor
    """Where to fly [m], world, (E, 3)."""

    position: Tensor
    """Body origin [m], world, (E, 3)."""

    attitude: Tensor
    """Body to world, xyzw, (E, 4)."""

    lin_vel: Tensor
    """Velocity [m/s], world, (E, 3)."""

    lin_vel_body: Tensor
    """Velocity [m/s], body, (E, 3)."""

    ang_vel_body: Tensor
    """Angular velocity [rad/s], body, (E, 3)."""

    actions: Tensor
    """Last action, (E, U)."""

    prev_actions: Tensor
    """Action before it, (E, U)."""

    crashed: Tensor
    """Whether the robot touched something, bool (E,)."""

    @classmethod
    def of(cls, tensors: Sequence[Tensor]) -> "TaskState":
        """Return the state of tensors in the order of the fields."""
        return cls(**dict(zip(cls.__dataclass_fields__, tensors, strict=True)))


@dataclass(frozen=True, kw_only=True)
class ObservationTerm:
    """A term and its width; width None is the width of the action."""

    width: int | None
    """Entries per environment."""

    value: Callable[[TaskState], Tensor]
    """Returns (E, width)."""


def position_error_world(state: TaskState) -> Tensor:
    """Return target minus position [m], world, (E, 3)."""
    return state.target - state.position


OBSERVATIONS: dict[str, ObservationTerm] = {
    "position_error_world": ObservationTerm(width=3, value=position_error_world),
    "attitude": ObservationTerm(width=4, value=lambda state: state.attitude),
    "lin_vel_world": ObservationTerm(width=3, value=lambda state: state.lin_vel),
    "lin_vel_body": ObservationTerm(width=3, value=lambda state: state.lin_vel_body),
    "ang_vel_body": ObservationTerm(width=3, value=lambda state: state.ang_vel_body),
    "last_action": ObservationTerm(width=None, value=lambda state: state.actions),
}
"""Terms by the name that a task configuration uses."""
