"""Rewards: pure functions of the states of one instant. No tensor in the parameters, no branch on a tensor.

Letters: E environments.
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

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


Reward = Callable[[TaskState, Mapping[str, float], Tensor], Tensor]

REWARDS: dict[str, tuple[Reward, tuple[str, ...]]] = {
    "position_setpoint": (
        position_setpoint,
        (
            "near_height", "near_width", "far_height", "far_width", "distance_offset", "distance_scale",
            "upright_height", "upright_offset", "spin_height", "crash",
        ),
    ),
}  # fmt: skip
"""Rewards and the names of their coefficients, by the name that a task configuration uses."""
