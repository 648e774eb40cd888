"""Thrust coefficient: one factor on thrust and drag torque of all rotors, from air density, propellers or wear.

``T = k T_declared`` and ``q = k q_declared`` at every speed: both are proportional to the density of the air.
Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.2.5: thrust and torque coefficient.
"""

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class ThrustCoefficient(VehicleEffect):
    """One factor on thrust and drag torque of all rotors."""

    name = "thrust_coefficient"
    summary = "one factor on thrust and drag torque of all rotors"
    acts_on = "rotor"
    parameters = (Parameter("scale", "-", 0.3, 3.0, 0.05, "true thrust per declared thrust", neutral=1.0),)
    excitation = "thrust, as any flight has; a wrong mass looks the same in the force and differs only in the torque"
    confused_with = ("payload_mass", "weak_motor", "battery_sag")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with scaled thrust and torque maps."""
        return vehicle.with_scaled_maps(thrust=params[:, :1], torque=params[:, :1])
