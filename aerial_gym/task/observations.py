"""Terms of observations: pure functions of the states of one instant.

Letters: E environments, U entries of a command, S sensors, H x W pixels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from aerial_gym.math.quaternion import euler_from_quat, quat_rotate_inverse, quat_yaw


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
    """Last command to the controller, (E, U)."""

    prev_actions: Tensor
    """Command before it, (E, U)."""

    crashed: Tensor
    """Whether the robot touched something, bool (E,)."""

    prev_distance: Tensor
    """Distance to the target one step before, or at the reset [m], (E,); 0 unless the reward asks for it."""

    difficulty: Tensor
    """How far the curriculum has come from its lowest (0) to its highest (1) level, (); 0 without one."""

    image: Tensor
    """Distances that the robot's first range sensor sees, as it gives them, (E, S, H, W); (E, 0, 0, 0) without one."""

    image_scale: Tensor
    """The largest distance in the unit of ``image``, and the share of it that stands for a cell in which no pixel holds a
    distance, (2,)."""

    nearest: Tensor
    """The smallest distance in each of ``IMAGE_CELLS`` cells of the image as a share of the largest, row by row from the upper
    left one, (E, rows * columns): cells have equal size, rounded up, so that the last row and column may be smaller. Pixels
    without a distance (negative) do not count; a cell that has no other shows ``image_scale[1]``. (E, 0) without a sensor."""

    apart: Tensor = field(default_factory=lambda: torch.zeros(0, 0))
    """Values of the observation terms that are no part of the task's kernel, side by side in their order, (E, W)."""

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

    needs_image: bool = False
    """Whether it looks at ``TaskState.image``."""


IMAGE_CELLS = (8, 8)
"""Rows and columns of the smallest distances that an observation holds of an image."""

TINY = 1e-6
"""A distance [m] below which there is no direction."""


def position_error_world(state: TaskState) -> Tensor:
    """Return target minus position [m], world, (E, 3)."""
    return state.target - state.position


def direction_vehicle(state: TaskState) -> Tensor:
    """Return the unit vector from the robot to the target, vehicle frame (world turned by the yaw), (E, 3)."""
    error = state.target - state.position
    return quat_rotate_inverse(quat_yaw(state.attitude), error / error.norm(dim=-1, keepdim=True).clamp_min(TINY))


def distance(state: TaskState) -> Tensor:
    """Return the distance to the target [m], (E, 1)."""
    return (state.target - state.position).norm(dim=-1, keepdim=True)


OBSERVATIONS: dict[str, ObservationTerm] = {
    "position_error_world": ObservationTerm(width=3, value=position_error_world),
    "attitude": ObservationTerm(width=4, value=lambda state: state.attitude),
    "lin_vel_world": ObservationTerm(width=3, value=lambda state: state.lin_vel),
    "lin_vel_body": ObservationTerm(width=3, value=lambda state: state.lin_vel_body),
    "ang_vel_body": ObservationTerm(width=3, value=lambda state: state.ang_vel_body),
    "direction_vehicle": ObservationTerm(width=3, value=direction_vehicle),
    "distance": ObservationTerm(width=1, value=distance),
    "roll_pitch": ObservationTerm(width=2, value=lambda state: euler_from_quat(state.attitude)[:, :2]),
    "zero": ObservationTerm(width=1, value=lambda state: torch.zeros_like(state.position[:, :1])),
    "nearest_in_cells": ObservationTerm(
        width=IMAGE_CELLS[0] * IMAGE_CELLS[1], value=lambda state: state.nearest, needs_image=True
    ),
    "last_action": ObservationTerm(width=None, value=lambda state: state.actions),
}
"""Terms by the name that a task configuration uses."""
