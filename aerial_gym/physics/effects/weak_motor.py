"""Weak motor: one rotor gives less, or more, thrust than declared at the same speed, as with a chipped or wrong propeller.

``T = k T_declared`` and ``q = k q_declared`` for that rotor: a blade that has lost area loses lift and drag with it.
Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.2.5: both coefficients grow with the blade area.
"""

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.one_rotor import ROTOR, rotor_mask
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class WeakMotor(VehicleEffect):
    """A factor on thrust and drag torque of one rotor."""

    name = "weak_motor"
    summary = "one rotor gives less thrust and drag torque than declared"
    acts_on = "rotor"
    parameters = (
        ROTOR,
        Parameter("scale", "-", 0.1, 2.0, 0.05, "true thrust per declared thrust", neutral=1.0),
    )
    excitation = "thrust that varies, and yaw: in hover alone a shifted centre of mass looks the same"
    confused_with = ("com_offset", "thrust_coefficient", "motor_tilt", "payload_mass")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the maps of one rotor scaled."""
        factor = 1.0 + rotor_mask(vehicle, params[:, 0]) * (params[:, 1:] - 1.0)
        return vehicle.with_scaled_maps(thrust=factor, torque=factor)
