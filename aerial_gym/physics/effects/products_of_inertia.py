"""Products of inertia: principal axes that are turned from the declared ones.

``J'_ij = J_ij + p_ij sqrt(J_ii J_jj)`` for i != j, with J the declared inertia matrix. So p is a correlation of the axes,
independent of the size of the vehicle and of ``inertia_error``. Within the bounds a diagonal J stays positive definite.
Source: Derived: unit diagonal and other entries p are positive definite if ``1 + 2 p_xy p_xz p_yz > sum p²``.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class ProductsOfInertia(VehicleEffect):
    """Off-diagonal entries of the inertia matrix beyond the declared ones."""

    name = "products_of_inertia"
    summary = "principal axes of inertia that are turned from the declared ones"
    acts_on = "inertia"
    parameters = tuple(
        Parameter(
            name=pair,
            unit="-",
            low=-0.45,
            high=0.45,
            scale=0.1,
            meaning=f"entry {pair} of the matrix beyond the declared one, per sqrt(J_{pair[0] * 2} J_{pair[1] * 2})",
        )
        for pair in ("xy", "xz", "yz")
    )
    excitation = "fast rotation about two axes, or torques about one axis while another one is still"
    confused_with = ("imu_misalignment", "motor_tilt", "com_offset", "inertia_error")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the products added."""
        size = vehicle.inertia.diagonal(dim1=-2, dim2=-1).sqrt()
        xy, xz, yz = params.unbind(-1)
        zero = torch.zeros_like(xy)
        share = torch.stack((zero, xy, xz, xy, zero, yz, xz, yz, zero), dim=-1).unflatten(-1, (3, 3))
        return replace(vehicle, inertia=vehicle.inertia + size.unsqueeze(-1) * share * size.unsqueeze(-2))
