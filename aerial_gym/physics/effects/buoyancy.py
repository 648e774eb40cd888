"""Buoyancy: the weight of displaced water pushes a hull up at the centre of its displaced volume.

With b from the body origin to the centre of buoyancy and c to the centre of mass, the force F along world z acts at b. Its
torque about the centre of mass, ``(b - c) x F``, rights a hull whose centre of buoyancy is above its centre of mass. The
buoyancy of air, a thousandth of it, is neglected elsewhere. The hull is always submerged: there is no surface.
Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, section 4.1 (submerged vehicles).
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.wrench import WrenchEffect
from aerial_gym.physics.effects.parameter import Parameter


class Buoyancy(WrenchEffect):
    """Upward force at a point of the hull."""

    name = "buoyancy"
    summary = "upward force of displaced water, at the centre of buoyancy"
    parameters = (
        Parameter("force", "N", 0.0, 1e5, 1.0, "weight of the displaced water"),
        *(Parameter(axis, "m", -5.0, 5.0, 0.01, f"centre of buoyancy from the body origin, {axis}") for axis in "xyz"),
    )
    excitation = "attitudes that differ"
    confused_with = ("payload_mass", "com_offset", "thrust_coefficient")
    rotors = ANY_ROTOR
    medium = "water"

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``F up`` and ``(b - c) x F up``."""
        return buoyancy_wrench(params[:, :1], params[:, 1:] - condition.vehicle.com, condition.up)


def buoyancy_wrench(force: Tensor, lever: Tensor, up: Tensor) -> Tensor:
    """Return force [N] and torque [N m], (..., 6), of an upward force [N], (..., 1).

    It acts at a lever [m] from the centre of mass; that and world z are in axes of the body, (..., 3).
    """
    push = force * up
    return torch.cat((push, torch.linalg.cross(lever, push)), dim=-1)
