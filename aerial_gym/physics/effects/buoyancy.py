"""The weight of the water that a hull displaces pushes it up, at the centre of the displaced volume.

With b from the body origin to the centre of buoyancy and c to the centre of mass, the force F along world z acts at b. Its
torque about the centre of mass, ``(b - c) x F``, rights a hull whose centre of buoyancy is above its centre of mass. Displaced
air is a thousandth of that, and left out elsewhere. The hull is under water wherever it is: there is no surface.
Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, section 4.1 (submerged vehicles).
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Condition, Parameter, WrenchEffect
from aerial_gym.physics.fused.functions import rotate_inverse


class Buoyancy(WrenchEffect):
    """Upward force at a point of the hull."""

    name = "buoyancy"
    summary = "upward force of displaced water, at the centre of buoyancy"
    parameters = (
        Parameter(name="force", unit="N", low=0.0, high=1e5, scale=1.0, meaning="weight of the displaced water"),
        *(
            Parameter(
                name=axis,
                unit="m",
                low=-5.0,
                high=5.0,
                scale=0.01,
                meaning=f"centre of buoyancy from the body origin, {axis}",
            )
            for axis in "xyz"
        ),
    )
    excitation = "attitudes that differ"
    confused_with = ("payload_mass", "com_offset", "thrust_coefficient")
    rotors = ANY_ROTOR
    medium = "water"

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``F up`` and ``(b - c) x F up``."""
        force = params[:, :1] * condition.up
        return torch.cat((force, torch.linalg.cross(params[:, 1:] - condition.vehicle.com, force)), dim=-1)

    def warp_wrench(self, condition: type) -> wp.Function:
        """Return the same in Warp."""

        @wp.func
        def buoyancy(at: condition, p: wp.vec4) -> wp.spatial_vector:
            force = rotate_inverse(at.attitude, wp.vec3(0.0, 0.0, p[0]))
            return wp.spatial_vector(force, wp.cross(wp.vec3(p[1], p[2], p[3]) - at.com, force))

        return buoyancy
