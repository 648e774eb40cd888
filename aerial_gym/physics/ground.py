"""Flat ground: whether a vehicle touches it. A flag alone; nothing pushes back.

Letters: E environments, C collision spheres.
"""

from dataclasses import dataclass

from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.physics.state import BodyState


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A horizontal plane and what of the vehicle can touch it."""

    height: float
    """Of the plane [m], world."""

    spheres: Tensor
    """Centres in the body frame and radii [m], (C, 4)."""

    contact: Tensor
    """Set to True, bool (E,), where the ground is touched at the end of a substep; never cleared by the physics."""


def touches_ground(ground: Ground, state: BodyState) -> Tensor:
    """Return whether the lowest point of a sphere is below the plane, ``p_z + (R c)_z - r < h``, bool (E,)."""
    center, radius = ground.spheres[:, :3], ground.spheres[:, 3]
    offset = quat_rotate(state.attitude.unsqueeze(1), center.unsqueeze(0).expand(state.num_envs, -1, -1))
    return (state.position[:, 2:] + offset[..., 2] - radius < ground.height).any(dim=1)
