"""Shifted centre of mass, with unchanged inertia about it.

It changes the levers of the rotors, ``tau = sum (r - c) x f``, and the acceleration ``alpha x r + w x (w x r)`` of a
body-fixed point at r from the centre of mass.
Source: Derived: Newton-Euler equations about the centre of mass, e.g. Featherstone (2008), Rigid Body Dynamics
Algorithms, section 2.15.
"""

from dataclasses import replace

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class ComOffset(VehicleEffect):
    """A shift of the centre of mass."""

    name = "com_offset"
    summary = "the centre of mass is shifted from its declared place"
    acts_on = "inertia"
    parameters = tuple(Parameter(axis, "m", -0.5, 0.5, 0.005, f"shift along body {axis}") for axis in "xyz")
    excitation = "x and y: any thrust; z: angular acceleration or rate together with the accelerometer"
    confused_with = ("weak_motor", "motor_tilt", "imu_bias")
    told_by_torques = True
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the shifted centre of mass."""
        return replace(vehicle, com=vehicle.com + params)
