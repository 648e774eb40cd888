"""An observation: the tilt of the vehicle."""

from torch import Tensor

from aerial_gym.math.quaternion import world_up


def tilt(robot_orientation: Tensor) -> Tensor:
    """Return ``1 - cos`` of the angle between body z and the vertical, (E, 1)."""
    return 1.0 - world_up(robot_orientation)[:, 2:]
