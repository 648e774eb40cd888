"""A reward: height that the episode has not reached before. It reads the buffer of ``highest.py``."""

from torch import Tensor


def new_height(highest: Tensor, robot_position: Tensor, *, scale: float = 1.0) -> Tensor:
    """Return ``scale`` times the height above the highest point so far [m], (E,)."""
    return scale * (robot_position[:, 2] - highest).clamp_min(0.0)
