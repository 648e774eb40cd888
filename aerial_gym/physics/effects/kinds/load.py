"""Effects of a body that hangs on the vehicle."""

from abc import abstractmethod
from dataclasses import dataclass

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Effect


@dataclass(frozen=True, kw_only=True)
class SuspensionMotion:
    """Motion of the body origin, on which a load hangs, without the load."""

    acceleration: Tensor  # Acceleration of the origin, gravity included [m/s²], world, (E, 3)
    mobility: Tensor  # Acceleration of the origin per force on it [1/kg], world, (E, 3, 3)
    gravity: float  # Downward acceleration of free fall [m/s²]


class LoadEffect(Effect):
    """A body that hangs on the body origin by a massless rigid link.

    Its memory is the direction of the link, a unit vector n away from the origin, and its rate n', world.
    """

    acts_on = "wrench"
    order, single = 9, "load"
    accelerates, needs_com, moves_with_body = True, True, True
    needs = ("lin_vel",)
    rotors = ANY_ROTOR
    on_joints = False
    memory = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)

    @abstractmethod
    def pull(self, suspension: SuspensionMotion, load: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return the load's force on the origin [N], world, (E, 3), and n'' [1/s²], (E, 3); ``load`` is (n, n'), (E, 6)."""
