"""Errors of the inertial sensors and of the rotor speed sensors."""

from abc import abstractmethod

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Effect


class ImuEffect(Effect):
    """An error of the inertial sensors; it does not change the motion."""

    acts_on = "sensor"
    rotors = ANY_ROTOR

    @abstractmethod
    def measure(self, specific_force: Tensor, ang_vel: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return the measured specific force [m/s²] and angular velocity [rad/s] for the true ones, body, each (E, 3)."""


class RotorSensorEffect(Effect):
    """An error of the rotor speed sensors; it does not change the motion."""

    acts_on = "sensor"

    @abstractmethod
    def measure(self, rotor_speed: Tensor, params: Tensor) -> Tensor:
        """Return the measured rotor speeds [rad/s], (E, R), for the true ones."""

    @abstractmethod
    def true_speed(self, measured: Tensor, params: Tensor) -> Tensor:
        """Return the true rotor speeds [rad/s], (E, R), for the measured ones: the inverse of ``measure``."""
