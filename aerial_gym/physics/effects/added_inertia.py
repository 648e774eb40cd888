"""Added inertia: water that rotates with a hull adds to its moment of inertia about each body axis.

``J = J_declared + diag(x, y, z)`` about the centre of mass.
Source: Lamb (1932), Hydrodynamics, articles 121-124; the other half of ``added_mass``.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class AddedInertia(VehicleEffect):
    """Inertia of the fluid about each body axis."""

    name = "added_inertia"
    summary = "water that rotates with a hull: added inertia about each body axis"
    acts_on = "inertia"
    parameters = tuple(Parameter(axis, "kg m²", 0.0, 1e4, 0.1, f"added inertia about body {axis}") for axis in "xyz")
    excitation = "angular accelerations about each body axis"
    confused_with = ("inertia_error",)
    rotors = ANY_ROTOR
    on_joints = False
    instead = ("link_added_mass",)
    medium = "water"

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the inertia added."""
        return replace(vehicle, inertia=vehicle.inertia + torch.diag_embed(params))
