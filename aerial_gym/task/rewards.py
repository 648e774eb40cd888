"""Rewards: pure functions of the states of one instant. No tensor in the parameters, no branch on a tensor.

Letters: E environments.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.control.laws import LAWS
from aerial_gym.task.observations import TaskState


def bell(x: Tensor, height: float, width: float) -> Tensor:
    """Return ``height exp(-width x²)``, the shape of the Aerial Gym Simulator's reward terms."""
    return height * torch.exp(-width * x * x)


def body_up_component(attitude: Tensor) -> Tensor:
    """Return the world z component of body z, ``R33 = 1 - 2 (x² + y²)``, (E,)."""
    return 1.0 - 2.0 * (attitude[:, 0] ** 2 + attitude[:, 1] ** 2)


def position_setpoint(state: TaskState, params: Mapping[str, float], crashed: Tensor) -> Tensor:
    """Return the reward of hovering at a point, (E,).

    ``r = pos + dist + pos (up + spin)`` with ``pos`` two bells of the distance, ``dist`` linear in it, ``up`` for an upright
    body, ``spin`` for a still one; a crash gives ``params["crash"]`` instead.

    Source:
        Aerial Gym Simulator 2.0.1, position_setpoint_task.
    """
    p = params
    distance = (state.target - state.position).norm(dim=-1)
    near, far = bell(distance, p["near_height"], p["near_width"]), bell(distance, p["far_height"], p["far_width"])
    position = near + far
    tilt = 1.0 - body_up_component(state.attitude)
    upright = p["upright_height"] / (p["upright_offset"] + tilt * tilt)
    spin = p["spin_height"] / (1.0 + (state.ang_vel_body * state.ang_vel_body).sum(-1))
    linear = (p["distance_offset"] - distance) / p["distance_scale"]
    reward = position + linear + position * (upright + spin)
    return torch.where(crashed, torch.full_like(reward, p["crash"]), reward)


def dip(x: Tensor, height: float, width: float) -> Tensor:
    """Return ``height (exp(-width x²) - 1)``: a penalty from 0 at x = 0 down to ``-height``."""
    return bell(x, height, width) - height


def navigation(state: TaskState, params: Mapping[str, float], crashed: Tensor) -> Tensor:
    """Return the reward of flying to a point between obstacles, (E,).

    ``r = k (near + far + progress + linear) + changes + c sizes`` with ``k = 1 + k_c c``, c the difficulty: two bells of
    the distance, the way gained (or lost, which weighs more) in this step, a linear part, and penalties of the command's
    forward and upward velocity and yaw rate and of their changes; a crash gives ``params["crash"]`` instead.

    Source:
        Aerial Gym Simulator 2.0.1, navigation_task. There the changes of the command are always 0.
    """
    p = params
    distance = (state.target - state.position).norm(dim=-1)
    gained = state.prev_distance - distance
    progress = torch.where(gained > 0.0, p["closer"], p["further"]) * gained
    near, far = bell(distance, p["near_height"], p["near_width"]), bell(distance, p["far_height"], p["far_width"])
    linear = (p["distance_offset"] - distance) / p["distance_scale"]
    change = state.actions - state.prev_actions
    changes, sizes = torch.zeros_like(distance), torch.zeros_like(distance)
    for column, name in ((0, "forward"), (2, "up"), (3, "yaw")):
        changes = changes + dip(change[:, column], p[f"{name}_change_height"], p[f"{name}_change_width"])
        sizes = sizes + dip(state.actions[:, column], p[f"{name}_height"], p[f"{name}_width"])
    scale = 1.0 + p["difficulty_scale"] * state.difficulty
    reward = scale * (near + far + progress + linear) + changes + state.difficulty * sizes
    return torch.where(crashed, torch.full_like(reward, p["crash"]), reward)


@dataclass(frozen=True, kw_only=True)
class Reward:
    """A reward and what it needs."""

    value: Callable[[TaskState, Mapping[str, float], Tensor], Tensor]
    """State, coefficients and whether the episode ends by a crash, bool (E,), to the reward (E,)."""

    params: tuple[str, ...]
    """Names of its coefficients."""

    needs_progress: bool = False
    """Whether it looks at ``TaskState.prev_distance``."""

    command: tuple[str, ...] | None = None
    """What the controller must take; None fits all."""


REWARDS: dict[str, Reward] = {
    "position_setpoint": Reward(
        value=position_setpoint,
        params=(
            "near_height", "near_width", "far_height", "far_width", "distance_offset", "distance_scale",
            "upright_height", "upright_offset", "spin_height", "crash",
        ),
    ),
    "navigation": Reward(
        value=navigation,
        params=(
            "near_height", "near_width", "far_height", "far_width", "closer", "further", "distance_offset",
            "distance_scale", "difficulty_scale", "crash",
            "forward_change_height", "forward_change_width", "up_change_height", "up_change_width", "yaw_change_height",
            "yaw_change_width", "forward_height", "forward_width", "up_height", "up_width", "yaw_height", "yaw_width",
        ),
        needs_progress=True,
        command=LAWS["velocity"].action,
    ),
}  # fmt: skip
"""Rewards by the name that a task configuration uses."""
