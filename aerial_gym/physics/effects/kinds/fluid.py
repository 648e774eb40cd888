"""Effects of fluid that moves with the body (added mass)."""

from abc import abstractmethod

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Effect
from aerial_gym.physics.effects.condition import Condition


class FluidEffect(Effect):
    """Fluid that moves with the body (added mass).

    The body then has a different mass along each of its axes, and follows Kirchhoff's equations (``physics.integrators``).
    """

    acts_on = "inertia"
    order, single = 3, "fluid"
    accelerates, needs_com = True, True
    rotors = ANY_ROTOR
    on_joints = False

    @abstractmethod
    def added_mass(self, params: Tensor) -> Tensor:
        """Return the mass of the fluid along each body axis [kg], (E, 3), from parameters (E, P)."""

    @abstractmethod
    def wrench_with_fluid(self, wrench: Tensor, condition: Condition, gravity: float, params: Tensor) -> Tensor:
        """Return the wrench without weight that gives the body alone the acceleration of body and fluid, (E, 6), body axes.

        Args:
            wrench: Force and torque of all other causes without gravity, body axes, (E, 6).
            condition: State and surroundings.
            gravity: Downward acceleration of free fall [m/s²].
            params: (E, P).
        """
