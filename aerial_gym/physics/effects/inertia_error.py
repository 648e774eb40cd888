"""Inertia error: factors on the declared moments of inertia about the body axes.

``J' = S J S`` with the diagonal ``S = sqrt(s)``: moments of inertia scale by s, and J' stays positive definite.
Source: Derived: a congruence keeps a matrix positive definite (Sylvester's law of inertia).
"""

from dataclasses import replace

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class InertiaError(VehicleEffect):
    """A factor on the moment of inertia about each body axis."""

    name = "inertia_error"
    summary = "moments of inertia that differ from the declared ones"
    acts_on = "inertia"
    parameters = tuple(
        Parameter(f"s{axis}", "-", 0.1, 10.0, 0.1, f"true per declared, body {axis}", neutral=1.0) for axis in "xyz"
    )
    excitation = "angular accelerations about each body axis"
    confused_with = ("torque_ratio", "thrust_coefficient", "rotor_inertia")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the inertia scaled."""
        stretch = params.sqrt()
        return replace(vehicle, inertia=stretch.unsqueeze(-1) * vehicle.inertia * stretch.unsqueeze(-2))
