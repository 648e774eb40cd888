"""Conversions between the simulation's units and those of Betaflight: sticks, motors and sensors.

Frames: body is x forward, y left, z up; the packets of Betaflight's simulator target have y right and z down.
Letters: E environments, R rotors.
"""

from math import degrees, pi

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.betaflight.controller import BetaflightController
from aerial_gym.firmware.betaflight.settings import STICK_RATE
from aerial_gym.firmware.environment import motor_order
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.physics.vehicle import Vehicle

MOTORS = (0, 1, 2, 3)  # Rear right, front right, rear left, front left. Source: Betaflight, mixer QUADX
COUNTS_PER_RAD_S = 16.384 * 180.0 / pi  # Of the firmware's gyro, 2000 deg/s at 32768
PACKET_COUNTS_PER_RAD_S = 16.4 * 180.0 / pi  # Factor on the rates of a packet. Source: platform/SIMULATOR/sitl.c
LOW, MIDDLE, HIGH = 1000.0, 1500.0, 2000.0  # Pulses [us]
BELOW_ALL = 950  # No throttle, below `min_check` [us]: the firmware arms, and holds integrals at zero without airmode
ROLL, PITCH, THROTTLE, YAW, ARM = range(5)  # Channels


class BetaflightVehicle:
    """A quadrotor as Betaflight sees it."""

    def __init__(self, twin: BetaflightController, vehicle: Vehicle) -> None:
        """Take a declared vehicle, and the controller of this package for it with gains, allocation and motor range.

        Raises:
            ConfigError: If the rotors are not four in an X with Betaflight's spins, or their reverse.
        """
        self._order, self.yaw_reversed = motor_order(twin.allocation.inverse[0], MOTORS)
        self.twin, self._vehicle = twin, vehicle
        self.takes_sticks = "stick" in twin.action_names[1]

    def channels(self, action: Tensor, out: NDArray[np.uint16]) -> None:
        """Write the channels [us], (E, 16), for thrust (0 is hover) and body rates [rad/s] or sticks, (E, 4)."""
        throttle = self.twin.throttle(action[:, :1] + 1.0).mean(-1)
        sticks = action[:, 1:] if self.takes_sticks else action[:, 1:] * (degrees(1.0) / STICK_RATE)
        sticks = sticks.clamp(-1.0, 1.0)
        out[:] = int(LOW)
        pulse = _pulse(throttle.clamp(0.0, 1.0), LOW, HIGH - LOW)
        out[:, THROTTLE] = np.where(pulse > LOW, pulse, BELOW_ALL)
        for channel, axis, sign in ((ROLL, 0, 1.0), (PITCH, 1, 1.0), (YAW, 2, -1.0)):
            out[:, channel] = _pulse(sign * sticks[:, axis], MIDDLE, HIGH - MIDDLE)
        out[:, ARM] = int(HIGH)

    def speeds(self, pulses: NDArray[np.float32]) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), for pulses [us] in Betaflight's order, (E, 16); the lowest without pulses."""
        return self.twin.speed_of_signal(self.signals(pulses).to(self.twin.allocation.inverse))

    def signals(self, pulses: NDArray[np.float32]) -> Tensor:
        """Return motor signals, 0 to 1, (E, R), for pulses [us] in Betaflight's order, (E, 16)."""
        return torch.from_numpy(pulses[:, self._order]).sub_(LOW).div_(HIGH - LOW).clamp_(0.0, 1.0)

    def thrust_of_throttle(self, signal: Tensor) -> Tensor:
        """Return thrust per weight, (E, 1), at a motor signal without corrections, (E, 1); the inverse of the throttle."""
        twin = self.twin
        thrust = rotor_thrust(self._vehicle, twin.speed_of_signal(signal.expand(-1, len(self._order))))
        return thrust[:, :1] / (twin.gains.weight * twin.allocation.inverse[:, :1, 2])


def _pulse(share: Tensor, base: float, span: float) -> NDArray[np.uint16]:
    return (base + span * share).round().cpu().numpy().astype(np.uint16)


def gyro_counts(ang_vel: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the counts of the firmware's gyro, whole numbers, for angular velocity [rad/s], body."""
    return np.rint(ang_vel.astype(np.float64) * COUNTS_PER_RAD_S).clip(-32767.0, 32767.0)


AT_REST, UPRIGHT = np.array([[0.0, 0.0, STANDARD_GRAVITY]]), np.array([[0.0, 0.0, 0.0, 1.0]])


def write_state(
    out: NDArray[np.float64], *, ang_vel: NDArray[np.floating], force: NDArray[np.floating] = AT_REST,
    attitude: NDArray[np.floating] = UPRIGHT,
) -> None:  # fmt: skip
    """Write packets of the firmware, (E, 18).

    The packet's rates are cut to counts by the firmware. A quarter of a count is added, so that it reads the nearest one.
    The time stays 0: the firmware then takes its clock for that of the simulation.

    Args:
        ang_vel: Angular velocity [rad/s], body, (E, 3).
        force: Specific force [m/s²], body, (E, 3) or (1, 3).
        attitude: Body to world, xyzw, (E, 4) or (1, 4).
    """
    counts = gyro_counts(ang_vel)
    out[:, 1:4] = (counts + 0.25 * np.sign(counts)) / PACKET_COUNTS_PER_RAD_S * (1.0, -1.0, -1.0)
    out[:, 4:7] = -force
    out[:, 7:11] = attitude[:, (3, 0, 1, 2)]
    out[:, 17] = 101325.0  # Pressure [Pa]
