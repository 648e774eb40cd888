"""A buffer: the largest height of an episode. Its decorator declares shape and unit."""

import torch
from torch import Tensor

from aerial_gym.task import BUFFERS


@BUFFERS.buffer(unit="m")
def highest(highest: Tensor, begun: Tensor, robot_position: Tensor) -> Tensor:
    """Return the largest height of the episode so far, (E,)."""
    return torch.where(begun, robot_position[:, 2], torch.maximum(highest, robot_position[:, 2]))
