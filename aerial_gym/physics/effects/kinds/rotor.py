"""Effects that change the thrust of each rotor."""

from abc import abstractmethod

from torch import Tensor

from aerial_gym.physics.effects.base import Effect
from aerial_gym.physics.effects.condition import Condition


class RotorEffect(Effect):
    """A change of the thrust of each rotor; the drag torque stays unchanged."""

    acts_on = "rotor"
    order = 1
    additive, accelerates, replayed = True, True, True
    at_hubs = True

    @abstractmethod
    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return the change of each rotor's thrust [N], (E, R), which is added to ``condition.rotor_thrust``."""
