"""Payload mass: additional or missing rigid mass at the centre of mass.

``m = m_declared + dm``; the inertia about the centre of mass stays as it is.
Source: Derived: Newton's second law.
"""

from dataclasses import replace

from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle

LEAST_SHARE = 0.7
"""Least mass with missing parts, as a share of the declared mass."""


class PayloadMass(VehicleEffect):
    """Mass at the centre of mass."""

    name = "payload_mass"
    summary = "mass that is not declared, at the centre of mass"
    acts_on = "inertia"
    parameters = (Parameter("dm", "kg", -10.0, 50.0, 0.02, "true minus declared mass"),)
    excitation = "thrust together with angular accelerations or drag: in hover alone a weaker thrust looks the same"
    confused_with = ("thrust_coefficient", "battery_sag", "weak_motor")
    rotors = ANY_ROTOR

    def bounds(self, robot: RobotCfg) -> list[tuple[float, float]]:
        """Return the bounds, with ``LEAST_SHARE`` of the declared mass as the least."""
        (most,) = self.parameters
        return [((LEAST_SHARE - 1.0) * robot.body.mass, most.high)]

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the mass added."""
        return replace(vehicle, mass=(vehicle.mass + params[:, 0]).maximum(LEAST_SHARE * vehicle.mass))
