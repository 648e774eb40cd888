"""Effects on rotor commands: a delay, and a change of the rotor speed that a command requests."""

from abc import abstractmethod
from typing import ClassVar

from torch import Tensor

from aerial_gym.physics.effects.base import Effect
from aerial_gym.physics.vehicle import Vehicle


class DelayEffect(Effect):
    """A delay of the commands. The backend keeps the commands of the longest delay."""

    acts_on = "actuation"
    order, single = 8, "delay"
    longest: ClassVar[float]  # Upper bound of the delay [s]

    @property
    def remembers(self) -> bool:
        """Whether it has memory of its own: the delayed commands."""
        return True

    @abstractmethod
    def delay(self, params: Tensor) -> Tensor:
        """Return the delay [s], (E,), from parameters (E, P)."""


class CommandEffect(Effect):
    """A change of the rotor speed that a command requests, such as by battery voltage or a motor failure."""

    acts_on = "actuation"
    order = 7

    @abstractmethod
    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the speeds [rad/s], (E, R), that the rotors approach under commanded speeds (E, R)."""

    def memory_from_voltage(self, voltage: Tensor) -> Tensor:
        """Return its memory along a flight, (T, M), from the logged battery voltage [V], (T,); that of a reset by default."""
        return voltage.new_tensor(self.memory).expand(len(voltage), -1)
