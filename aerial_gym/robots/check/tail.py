"""Hover and control authority of a tricopter, whose tail servo tilts the tail rotor to give yaw torque.

The unknowns at hover are the thrusts of the other rotors and two components of the tail's thrust, along body z and along -y
(a positive angle). Force and torque are linear in these; thrust and angle are their length and direction.
The rotor points along body z in the reference pose, its joint's axis runs through its hub: ``derive_tail_servo`` takes it so.
Frames: body is x forward, y left, z up. Letters: R rotors.
"""

from collections.abc import Callable, Sequence
from math import atan2, hypot

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.robots.joints.tail_servo import derive_tail_servo, tail_rotor

Array = NDArray[np.float64]

HALVINGS = 60  # Of a factor, to rounding
LARGEST = 1e6  # Force [N] or torque [N m] that is more than any rotor gives


class TailRotorModel:
    """Forces and torques of such a vehicle, about the angle at which its tail holds hover.

    Args:
        matrix: Force and torque per thrust of each rotor as all point along their axes in the reference pose, (6, R).
        low: Lowest thrusts [N], (R,).
        high: Highest thrusts [N], (R,).
        gravity: Downward acceleration of free fall [m/s²].

    Raises:
        ConfigError: If no rotor of the robot is a tail on a servo.
    """

    def __init__(
        self, robot: RobotCfg, matrix: Array, low: Array, high: Array, *, gravity: float = STANDARD_GRAVITY
    ) -> None:
        self.tail = tail_rotor(robot)
        self.angles = derive_tail_servo(robot, dt=0.0, gravity=gravity).limits
        self._low, self._high = low, high
        upright = matrix[:, self.tail]
        arm = np.subtract(robot.mounts.layout[self.tail].position, robot.body.com)
        drag = upright[3:] - np.cross(arm, upright[:3])  # torque of the rotor itself, along its axis
        side = np.array([0.0, -1.0, 0.0])
        lean = np.concatenate((side, np.cross(arm, side) + drag[2] * side))
        self.columns = np.column_stack((matrix, lean))
        self._inverse = np.linalg.pinv(self.columns[2:])

    def unknowns_of_lift(self, lift: float, torque: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
        """Return the unknowns for a force along z [N] and a torque [N m]: thrusts, the tail's z and -y components [N]."""
        return self._inverse @ np.array([lift, *torque])

    def rotor_thrusts(self, unknowns: Array) -> Array:
        """Return the thrust of each rotor [N], (R,)."""
        values = unknowns[:-1].copy()
        values[self.tail] = hypot(unknowns[self.tail], unknowns[-1])
        return values

    def tail_angle(self, unknowns: Array) -> float:
        """Return the angle of the tail [rad]."""
        return atan2(unknowns[-1], unknowns[self.tail])

    def wrench(self, unknowns: Array) -> Tensor:
        """Return force [N] and torque [N m], (6,), without the tail's side force, which roll balances."""
        values = self.columns @ unknowns
        values[1] += unknowns[-1]
        return torch.from_numpy(values)

    def roll(self, unknowns: Array) -> float:
        """Return the angle about x [rad] at which the weight balances the side force."""
        force = self.columns @ unknowns
        return atan2(force[1], force[2])

    def first_limited_rotor(self, unknowns: Array) -> int | None:
        """Return the index of the first rotor beyond its limits, for the tail also the servo's; None if all are within."""
        thrusts = self.rotor_thrusts(unknowns)
        beyond = np.flatnonzero((thrusts < self._low) | (thrusts > self._high))
        if beyond.size:
            return int(beyond[0])
        return None if self.angles[0] <= self.tail_angle(unknowns) <= self.angles[1] else self.tail

    def control_margin(self, lift: float, axis: int) -> tuple[float, int | None]:
        """Return the symmetric control margin at a lift [N], and the number from 0 of the limiting rotor or its servo.

        Axis 0 is the force along z [N], 1 to 3 are the torques about x, y, z [N m].
        """
        hover, step = self.unknowns_of_lift(lift), self._inverse[:, axis]
        return _largest_command_within_limits(
            lambda size: next(
                (
                    rotor
                    for way in (1, -1)
                    if (rotor := self.first_limited_rotor(hover + way * size * step)) is not None
                ),
                None,
            )
        )

    def largest_lift(self) -> float:
        """Return the largest force along z without torque [N]."""
        return _largest_command_within_limits(
            lambda size: next(
                iter(np.flatnonzero(self.rotor_thrusts(self.unknowns_of_lift(size)) > self._high).tolist()), None
            )
        )[0]


def _largest_command_within_limits(stopped_by: Callable[[float], int | None]) -> tuple[float, int | None]:
    """Return the largest size without a violation, and the first violation beyond it."""
    size, ends, last = 0.0, LARGEST, None
    for _ in range(HALVINGS):
        middle = 0.5 * (size + ends)
        stopped = stopped_by(middle)
        size, ends, last = (middle, ends, last) if stopped is None else (size, middle, stopped)
    return size, last


def tail_rotor_model(
    robot: RobotCfg, matrix: Array, low: Array, high: Array, *, gravity: float = STANDARD_GRAVITY
) -> TailRotorModel | None:
    """Return the model of a vehicle with a tail servo; None without one."""
    try:
        return TailRotorModel(robot, matrix, low, high, gravity=gravity)
    except ConfigError:
        return None
