"""Torque ratio: one factor on the drag torque of all rotors, at unchanged thrust.

``q = k q_declared`` at every speed.
Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.2.5: torque coefficient.
"""

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class TorqueRatio(VehicleEffect):
    """One factor on the drag torque of all rotors."""

    name = "torque_ratio"
    summary = "one factor on the drag torque of all rotors"
    acts_on = "rotor"
    parameters = (Parameter("scale", "-", 0.1, 5.0, 0.1, "true drag torque per declared one", neutral=1.0),)
    excitation = "yaw accelerations that the rotors cause"
    confused_with = ("inertia_error", "motor_tilt", "rotor_inertia")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with a scaled torque map."""
        return vehicle.with_scaled_maps(torque=params[:, :1])
