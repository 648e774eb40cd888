"""Check the order of the rotor columns by the torques that they predict. Letters: T rows, R rotors, N orders."""

from collections.abc import Callable
from itertools import permutations

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, rotor_wrench
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.logs.checks.conventions import WORST_AGREEMENT
from aerial_gym.sim2real.logs.checks.kinematics import CHECK_BANDWIDTH_HZ
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import edge_rows, lowpass

MOST_ROTORS = 6  # More rotors have too many orders to try
BETTER = 0.4  # Another order is accepted if its residual is less than this share of the declared order's


def check_rotor_order(log: FlightLog, robot: RobotCfg) -> None:
    """Raise ``DataError`` if another order of the rotor columns predicts the angular acceleration much better."""
    if log.ang_vel is None or log.collective or not log.torques or not 2 <= robot.num_rotors <= MOST_ROTORS:
        return
    rate = sample_rate(log)
    edge, stride = edge_rows(rate, CHECK_BANDWIDTH_HZ), max(1, round(rate / (5.0 * CHECK_BANDWIDTH_HZ)))

    def slow(values: Array, *, derivative: bool = False) -> Array:
        filtered = lowpass(values, rate, CHECK_BANDWIDTH_HZ, derivative=derivative)[edge:-edge:stride]
        return filtered - filtered.mean(axis=0)

    inertia = np.array(robot.body.inertia)
    turning = slow(log.ang_vel, derivative=True)
    turning = turning + slow(np.cross(log.ang_vel, log.ang_vel @ inertia)) @ np.linalg.inv(inertia)
    for name, values in (("rotor", log.rotor_speed), ("cmd", log.rotor_command)):
        if values is None:
            continue
        orders = np.array(list(permutations(range(robot.num_rotors))))  # the declared order is first
        misses = _residuals_of_rotor_orders(robot, turning, slow, values, orders, inertia)
        best = int(np.argmin(misses))
        if misses[0] > WORST_AGREEMENT and misses[best] < BETTER * misses[0]:
            columns = ", ".join(f"{name}_{column + 1}" for column in orders[best])
            raise DataError(
                f"{log.path}: {name}_1..{robot.num_rotors} in the declared order predict the angular acceleration with an "
                f"error of {misses[0]:.0%}; the probable order is {columns}: reorder the columns or the robot's mounts"
            )


def _residuals_of_rotor_orders(
    robot: RobotCfg,
    turning: Array,
    slow: Callable[[Array], Array],
    values: Array,
    orders: Indices,
    inertia: Array,
) -> Array:
    """Return the relative residual of the angular acceleration under each order, mean over axes, (N,)."""
    one, count = vehicle_from_config(robot, num_envs=1, dtype=torch.float64), robot.num_rotors
    single, none = torch.eye(count, dtype=torch.float64), torch.zeros(count, count, dtype=torch.float64)
    lever, reaction = (rotor_wrench(one, *pair)[1].numpy() for pair in ((single, none), (none, single)))
    speed = torch.from_numpy(values)
    thrust, drag = (slow(values(one, speed).numpy()) for values in (rotor_thrust, rotor_torque))
    torque = np.einsum("tnr,rk->ntk", thrust[:, orders], lever) + np.einsum("tnr,rk->ntk", drag[:, orders], reaction)
    left = np.mean((turning - torque @ np.linalg.inv(inertia)) ** 2, axis=1)
    return np.sqrt(np.mean(left / np.maximum(np.mean(turning**2, axis=0), 1e-300), axis=1))
