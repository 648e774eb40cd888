"""Ground effect: rotors near the ground give more thrust at the same speed, because it blocks their wake.

``T' = T / (1 - k (R / 4 h)²)`` for a rotor of radius R with its hub at a distance h from the surface in its wake. That is the
ground for upward thrust, by the sign of T and the axis of the rotor, and the ceiling for downward thrust. The other surface has
``ceiling_effect``. The gain vanishes with the thrust, and does not depend on tilt, because the sources are for level rotors.
k = 1 for a single rotor by the method of images, and larger for several: the source for multirotors, with four rotors 3 R
apart, gives about 2.5 at a height of 3 R, and 10 with the fountain that lifts the body between them. The gain is constant
below ``h = R / 2``, where the formula does not hold; thrust is at most doubled.
Source: Cheeseman, Bennett (1955), The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021; factor
for multirotors: Sanchez-Cuevas, Heredia, Ollero (2017), Characterization of the aerodynamic ground effect. For thrust that
points down derived: such a rotor is the mirror image of one over the ground.
"""

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.rotor import RotorEffect
from aerial_gym.physics.effects.parameter import Parameter

LOWEST = 0.5
"""Least effective height of a hub, in radii."""

LARGEST_SHARE = 0.5
"""Largest share of the thrust due to the ground, which doubles the thrust."""


class GroundEffect(RotorEffect):
    """Gain of thrust near the ground."""

    name = "ground_effect"
    summary = "gain of thrust near the ground"
    parameters = (Parameter("k", "-", 0.0, 30.0, 3.0, "strength; 1 is a rotor by itself"),)
    excitation = (
        "flight within two rotor diameters of the ground, and away from it; heights above the ground in the log"
    )
    confused_with = ("thrust_coefficient", "battery_sag", "axial_inflow")
    rotors = ANY_ROTOR
    needs_radius = True
    follows = ("position",)
    needs = ("position",)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T (1 / (1 - s / h²) - 1) = T s / (h² - s)`` with ``s = k (R / 4)²``."""
        radius = condition.vehicle.rotor_radius
        height = condition.wake_room.maximum(LOWEST * radius)
        strength = params[:, :1] * (0.25 * radius).square()
        square = height.square().maximum(strength / LARGEST_SHARE)
        return condition.rotor_thrust * strength / (square - strength)
