"""Effects that change parameters of the vehicle, such as its mass or a thrust coefficient."""

from abc import abstractmethod

from torch import Tensor

from aerial_gym.physics.effects.base import Effect
from aerial_gym.physics.vehicle import Vehicle


class VehicleEffect(Effect):
    """A change of the vehicle's parameters, made once: it costs nothing in a step."""

    @abstractmethod
    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the effect applied; ``params`` is (E, P)."""
