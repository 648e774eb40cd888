"""What the rotors of a declared robot give at logged states: speeds [rad/s], in force mode thrusts [N].

Letters: T rows of a log, R rotors.
"""

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.effects.one_rotor import declared_lag
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.signals import lagged


def thrusts(robot: RobotCfg, speed: Array) -> Array:
    """Return the thrusts [N], (T, R), at states (T, R)."""
    rows = vehicle_from_config(robot, num_envs=len(speed), dtype=torch.float64)
    return rotor_thrust(rows, torch.from_numpy(np.ascontiguousarray(speed, dtype=float))).numpy()


def drag_torques(robot: RobotCfg, speed: Array) -> Array:
    """Return the drag torques [N m], (T, R), at states (T, R)."""
    rows = vehicle_from_config(robot, num_envs=len(speed), dtype=torch.float64)
    return rotor_torque(rows, torch.from_numpy(np.ascontiguousarray(speed, dtype=float))).numpy()


def lift(robot: RobotCfg, speed: Array) -> Array:
    """Return the size of the force of all rotors together [N], (T,), at states (T, R); they may point anywhere."""
    axes = np.array([mount.axis for mount in robot.mounts.layout])
    return np.linalg.norm(thrusts(robot, speed) @ (axes / np.linalg.norm(axes, axis=1, keepdims=True)), axis=1)


def mean_lag(robot: RobotCfg) -> float:
    """Return the mean of the declared time constants up and down [s]."""
    return 0.5 * sum(declared_lag(robot))


def followed(robot: RobotCfg, command: Array, rate: float) -> Array:
    """Return what the declared lag makes of commands (T, R) at a rate [Hz]: rotors that are cut carry on for a while."""
    kept = float(np.exp(-1.0 / (rate * mean_lag(robot))))
    return lagged(command, kept, command[0])
