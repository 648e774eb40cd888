"""What effects on rotors share: which one it is, and the lags that are declared."""

from statistics import fmean

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle

MOST_ROTORS = 64

ROTOR = Parameter(
    name="motor", unit="-", low=1, high=MOST_ROTORS, scale=1.0, meaning="which rotor, from 1 on", kind="rotor"
)


def declared_lag(robot: RobotCfg) -> tuple[float, float]:
    """Return the declared time constants of rise and of fall [s], the means over the rotors."""
    rotors = robot.rotor_types
    return fmean(rotor.time_constant_up for rotor in rotors), fmean(rotor.time_constant_down for rotor in rotors)


def chosen_rotor(vehicle: Vehicle, motor: Tensor) -> Tensor:
    """Return 1 at the rotor that ``motor`` (E,), counted from 1, names, and 0 elsewhere, (E, R)."""
    numbers = torch.arange(1, vehicle.num_rotors + 1, device=motor.device)
    return (numbers == motor.round().unsqueeze(1)).to(vehicle.rotor_spin.dtype)
