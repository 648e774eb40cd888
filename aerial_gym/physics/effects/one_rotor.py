"""Common parts of effects on one rotor: its index parameter, and the declared lags."""

from statistics import fmean

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle

MOST_ROTORS = 64

ROTOR = Parameter("motor", "-", 1, MOST_ROTORS, 1.0, "which rotor, from 1 on", neutral=1.0, kind="rotor")


def nominal_lag(robot: RobotCfg) -> tuple[float, float]:
    """Return the declared time constants of rise and fall [s], as means over the rotors."""
    rotors = robot.rotor_types
    return fmean(rotor.time_constant_up for rotor in rotors), fmean(rotor.time_constant_down for rotor in rotors)


def rotor_mask(vehicle: Vehicle, motor: Tensor) -> Tensor:
    """Return a mask (E, R) with 1 at the rotor of number ``motor`` (E,), counted from 1, and 0 elsewhere."""
    numbers = torch.arange(1, vehicle.num_rotors + 1, device=motor.device)
    return (numbers == motor.round().unsqueeze(1)).to(vehicle.rotor_spin.dtype)
