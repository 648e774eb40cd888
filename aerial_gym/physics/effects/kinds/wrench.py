"""Effects that put a force and torque on the body."""

from abc import abstractmethod

from torch import Tensor

from aerial_gym.math.rows import dot
from aerial_gym.physics.effects.base import Effect
from aerial_gym.physics.effects.condition import Condition


class WrenchEffect(Effect):
    """A force and torque on the body."""

    acts_on = "wrench"
    order = 2
    additive, accelerates, replayed = True, True, True

    @abstractmethod
    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force [N] and torque about the centre of mass [N m], body axes, (E, 6)."""


class LinearWrenchEffect(WrenchEffect):
    """A force and torque on the body that is linear in its parameters."""

    @abstractmethod
    def regressor(self, condition: Condition) -> Tensor:
        """Return the matrix (E, 6, P) that maps parameters to force [N] and torque about the centre of mass [N m], body."""

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque (E, 6), body axes: the regressor times the parameters (E, P)."""
        return linear_wrench(self.regressor(condition), params)


def linear_wrench(regressor: Tensor, params: Tensor) -> Tensor:
    """Return force and torque (E, 6) of a regressor (E, 6, P) and parameters (E, P)."""
    return dot(regressor, params.unsqueeze(1))
