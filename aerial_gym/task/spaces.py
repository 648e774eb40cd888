"""Gymnasium spaces of a task's actions and observations; Gymnasium is imported on demand."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch

from aerial_gym.config.task import OBSERVATIONS, POLICY
from aerial_gym.task.vision.images import TaskImages

if TYPE_CHECKING:
    from gymnasium import spaces


def group_key(group: str) -> str:
    """Return the observation key of a group."""
    return OBSERVATIONS if group == POLICY else group


def observation_space(widths: Mapping[str, int], images: TaskImages) -> "spaces.Dict":
    """Return the space of an observation of one environment: vectors of these widths by name, and the images."""
    from gymnasium import spaces

    entries: dict[str, spaces.Space] = {}
    for name, width in widths.items():
        bound = np.full(width, np.inf, dtype=np.float32)
        entries[name] = spaces.Box(-bound, bound, dtype=np.float32)
    for name, frames in images.frames.items():
        high = 255 if frames.dtype == torch.uint8 else 1
        kind = torch.empty(0, dtype=frames.dtype).numpy().dtype.type
        entries[name] = spaces.Box(0, high, shape=tuple(frames.shape[1:]), dtype=kind)
    return spaces.Dict(entries)


def action_space(num_actions: int) -> "spaces.Box":
    """Return the space of an action of one environment, each entry -1 to 1."""
    from gymnasium import spaces

    one = np.ones(num_actions, dtype=np.float32)
    return spaces.Box(-one, one, dtype=np.float32)
