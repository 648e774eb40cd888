"""Motor asymmetry: different lags of rising and falling rotor speeds, because drag alone brakes a rotor.

``tau_up dw/dt = w_command - w`` for a command above the speed, with ``tau_down`` for one below.
Source: Foerster (2015), System identification of the Crazyflie 2.0, section 3.3, measures steps of both signs.
"""

from dataclasses import replace

from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.one_rotor import nominal_lag
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class MotorAsymmetry(VehicleEffect):
    """Two time constants for all rotors, in place of the declared ones."""

    name = "motor_asymmetry"
    summary = "different first-order lags of rising and falling rotor speeds, in place of the declared ones"
    acts_on = "actuation"
    parameters = (
        Parameter("tau_up", "s", 1e-3, 1.0, 0.01, "time constant of rise"),
        Parameter("tau_down", "s", 1e-3, 1.0, 0.01, "time constant of fall"),
    )
    excitation = "quick changes of the rotor commands, up and down"
    contains = ("motor_time_constant",)
    confused_with = ("motor_time_constant", "actuation_delay", "battery_sag")
    rotors = ANY_ROTOR

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return the declared lags, as means over the rotors."""
        return nominal_lag(robot)

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with both time constants replaced."""
        up, down = (params[:, k : k + 1].expand_as(vehicle.time_constant_up) for k in (0, 1))
        return replace(vehicle, time_constant_up=up, time_constant_down=down)
