"""Effects that move the air."""

from abc import abstractmethod

import warp as wp
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Effect


class WindEffect(Effect):
    """A velocity of the air that depends on the position."""

    acts_on = "environment"
    twin, order = "warp_wind", 0
    additive, accelerates, needs_com = True, True, True
    rotors = ANY_ROTOR

    @abstractmethod
    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the velocity of the air [m/s], world, (E, 3), at ``position`` [m], world, (E, 3)."""

    def warp_wind(self) -> wp.Function | None:
        """Return the twin of ``wind``, a ``wp.func`` (position: wp.vec3, params: vector of P) -> wp.vec3; None: torch only."""
        return None
