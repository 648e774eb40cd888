"""Effects that move the air."""

from abc import abstractmethod

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Effect


class WindEffect(Effect):
    """A velocity of the air that depends on the position."""

    acts_on = "environment"
    order = 0
    additive, accelerates, needs_com = True, True, True
    rotors = ANY_ROTOR

    @abstractmethod
    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the velocity of the air [m/s], world, (E, 3), at ``position`` [m], world, (E, 3)."""
