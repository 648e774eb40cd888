"""Effects that change the thrust of each rotor."""

from abc import abstractmethod

import warp as wp
from torch import Tensor

from aerial_gym.physics.effects.base import Effect
from aerial_gym.physics.effects.condition import Condition


class RotorEffect(Effect):
    """A change of the thrust of each rotor; the drag torque stays unchanged."""

    acts_on = "rotor"
    twin, order = "warp_thrust", 1
    warp_fields = ("rotor_lever", "rotor_radius")
    additive, accelerates, replayed = True, True, True
    at_hubs = True

    @abstractmethod
    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return the change of each rotor's thrust [N], (E, R), which is added to ``condition.rotor_thrust``."""

    def warp_thrust(self, condition: type, hub: type) -> wp.Function | None:
        """Return the twin of ``thrust`` for one rotor; None: torch only.

        Args:
            condition: The ``wp.struct`` with the fields of ``Condition`` for this number of rotors.
            hub: The ``wp.struct`` with the air and the surroundings of one rotor.

        Returns:
            A ``wp.func`` (condition, hub, params: vector of P) -> thrust [N].
        """
        del condition, hub
        return None
