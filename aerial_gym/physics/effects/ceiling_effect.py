"""Ceiling effect: rotors close below a ceiling give more thrust at the same speed, because the surface restricts their inflow.

``T' = T / (1 - k (R / 4 h)²)`` for a rotor of radius R with its hub at a distance h from the surface at its inlet. That is the
ceiling for upward thrust, by the sign of T and the axis of the rotor, and the ground for downward thrust, as of a reversed
rotor. The other surface has ``ground_effect``. The gain is constant below ``h = R / 2``, where the formula does not hold, and
beyond the surface.
Source: Powers, Mellinger, Kushleyev, Kothmann, Kumar (2013), Influence of aerodynamics and proximity effects in quadrotor
flight: ``T / T' = 1 - (1 / a_1) (R / (h + a_2))²`` near a ceiling; here a_2 = 0, and ``k = 16 / a_1`` is the factor of
``ground_effect``, so that their strengths compare. For thrust that points down derived, as there.
"""

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.rotor import RotorEffect
from aerial_gym.physics.effects.parameter import Parameter

CLOSEST = 0.5
"""Least effective distance of a hub, in radii."""


class CeilingEffect(RotorEffect):
    """Gain of thrust near a ceiling."""

    name = "ceiling_effect"
    summary = "gain of thrust near the ceiling"
    parameters = (Parameter("k", "-", 0.0, 3.5, 1.0, "strength, as of ground_effect"),)
    excitation = "flight within two rotor diameters of the ceiling, and away from it; its height"
    confused_with = ("thrust_coefficient", "battery_sag", "ground_effect")
    rotors = ANY_ROTOR
    needs_radius = True
    follows = ("position",)
    needs = ("position", "ceiling_height")

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T (1 / (1 - s / h²) - 1) = T s / (h² - s)`` with ``s = k (R / 4)²``."""
        radius = condition.vehicle.rotor_radius
        room = condition.inlet_room.maximum(CLOSEST * radius)
        strength = params[:, :1] * (0.25 * radius).square()
        return condition.rotor_thrust * strength / (room.square() - strength)
