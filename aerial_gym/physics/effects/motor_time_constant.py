"""Motor time constant: the true lag of the rotors, equal for rise and fall, in place of the declared one.

``tau dw/dt = w_command - w``. It acts between command and speed, so flights without commands cannot show it.
Source: Pounds, Mahony, Corke (2010), Modelling and control of a large quadrotor robot, section 3.3.
"""

from dataclasses import replace

from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.one_rotor import nominal_lag
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class MotorTimeConstant(VehicleEffect):
    """One time constant for all rotors, in place of the declared ones."""

    name = "motor_time_constant"
    summary = "the true first-order lag of the rotor speeds, in place of the declared one"
    acts_on = "actuation"
    parameters = (Parameter("tau", "s", 1e-3, 1.0, 0.01, "time constant of rise and fall"),)
    excitation = "quick changes of the rotor commands"
    confused_with = ("motor_asymmetry", "actuation_delay", "battery_sag")
    rotors = ANY_ROTOR

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return the mean of the declared rise and fall."""
        return (0.5 * sum(nominal_lag(robot)),)

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with both time constants replaced."""
        tau = params[:, :1].expand_as(vehicle.time_constant_up)
        return replace(vehicle, time_constant_up=tau, time_constant_down=tau)
