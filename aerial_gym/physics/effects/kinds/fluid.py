"""Effects of fluid that moves with the body (added mass)."""

from abc import abstractmethod

import warp as wp
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Effect
from aerial_gym.physics.effects.condition import Condition


class FluidEffect(Effect):
    """Fluid that moves with the body (added mass).

    The body then has a different mass along each of its axes, and follows Kirchhoff's equations (``physics.kirchhoff``).
    """

    acts_on = "inertia"
    twin, order, single = "warp_entrain", 3, "fluid"
    warp_fields = ("other_position", "rotor_lever", "rotor_radius")
    accelerates, needs_com = True, True
    rotors = ANY_ROTOR
    on_joints = False

    @abstractmethod
    def added_mass(self, params: Tensor) -> Tensor:
        """Return the mass of the fluid along each body axis [kg], (E, 3), from parameters (E, P)."""

    def warp_added_mass(self) -> wp.Function | None:
        """Return the twin of ``added_mass``, a ``wp.func`` (params: vector of P) -> wp.vec3; None: torch only."""
        return None

    @abstractmethod
    def entrain(self, wrench: Tensor, condition: Condition, gravity: float, params: Tensor) -> Tensor:
        """Return the wrench without weight that gives the body alone the acceleration of body and fluid, (E, 6), body axes.

        Args:
            wrench: Force and torque of all other causes without gravity, body axes, (E, 6).
            condition: State and surroundings.
            gravity: Downward acceleration of free fall [m/s²].
            params: (E, P).
        """

    def warp_entrain(self, condition: type) -> wp.Function | None:
        """Return the twin of ``entrain``; None: torch only.

        Args:
            condition: The ``wp.struct`` with the fields of ``Condition`` for this number of rotors.

        Returns:
            A ``wp.func`` (wrench: wp.spatial_vector, condition, mass [kg], gravity, params: vector of P) -> wp.spatial_vector.
        """
        del condition
        return None
