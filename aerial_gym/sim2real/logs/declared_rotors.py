"""What the rotors of a declared robot give at logged speeds.

Letters: T rows of a log, R rotors.
"""

import numpy as np
import torch
from numpy.typing import NDArray

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque

Array = NDArray[np.float64]


def check_speed_mode(robot: RobotCfg) -> None:
    """Raise ``ConfigError`` if the robot has rotors in force mode: logs hold speeds, which those do not have."""
    if "force" in robot.rotor_traits:
        raise ConfigError(
            "the robot has rotors in force mode, whose state is a thrust; flights are compared by rotor speeds. "
            "Declare them in speed mode, with a thrust_map"
        )


def thrusts(robot: RobotCfg, speed: Array) -> Array:
    """Return the thrusts [N], (T, R), at speeds [rad/s], (T, R)."""
    rows = vehicle_from_config(robot, num_envs=len(speed), dtype=torch.float64)
    return rotor_thrust(rows, torch.from_numpy(np.ascontiguousarray(speed, dtype=float))).numpy()


def drag_torques(robot: RobotCfg, speed: Array) -> Array:
    """Return the drag torques [N m], (T, R), at speeds [rad/s], (T, R)."""
    rows = vehicle_from_config(robot, num_envs=len(speed), dtype=torch.float64)
    return rotor_torque(rows, torch.from_numpy(np.ascontiguousarray(speed, dtype=float))).numpy()
