"""Cascaded autopilot for the declared vehicle: position, velocity, attitude, rate, mixer.

It knows the declared numbers only; integral action in velocity and rate carries whatever the declaration lacks.
Letters: F flights.

Source: structure and feed-forward after D. Mellinger and V. Kumar, "Minimum snap trajectory generation and control for
quadrotors", ICRA 2011, with a rate loop inside.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.undeclared.dynamics import cross_matrix, wrench_map
from benchmarks.undeclared.sensors import Sample
from benchmarks.undeclared.trajectories import Reference
from benchmarks.undeclared.vehicle import GRAVITY, Array, PlantVehicle


@dataclass(frozen=True, kw_only=True)
class PlantGains:
    """Loops from slow to fast; stable for a rotor lag up to 0.1 s, checked by flying."""

    position: float = 1.8  # Velocity per position error [1/s]
    velocity: float = 3.2  # Acceleration per velocity error [1/s]
    velocity_integral: float = 2.5  # Acceleration per integrated velocity error [1/s²]
    attitude: tuple[float, float, float] = (7.0, 7.0, 3.0)  # Rate per angle error about the body axes [1/s]
    rate: tuple[float, float, float] = (20.0, 20.0, 8.0)  # Angular acceleration per rate error [1/s]

    rate_integral: tuple[float, float, float] = (30.0, 30.0, 10.0)
    """Angular acceleration per integrated rate error [1/s²]."""

    rate_derivative: float = 0.15  # Angular acceleration per measured angular acceleration, against it [1]
    derivative_filter: float = 0.005  # Lag of the measured angular acceleration [s]
    max_tilt: float = float(np.deg2rad(50.0))  # Largest commanded tilt [rad]

    max_integral: tuple[float, float] = (6.0, 90.0)
    """Limits of the integrals: acceleration [m/s²] and angular acceleration [rad/s²]."""


def unit_rows(vector: Array) -> Array:
    """Return each row divided by its length."""
    return vector / np.sqrt((vector * vector).sum(axis=1, keepdims=True))


def row_cross_product(a: Array, b: Array) -> Array:
    """Return the cross product of each row."""
    return (cross_matrix(a) @ b[:, :, None])[:, :, 0]


class Autopilot:
    """Turns samples into rotor speed commands for F flights; keeps the integrals of each."""

    def __init__(self, declared: PlantVehicle, num_flights: int, dt: float, gains: PlantGains | None = None) -> None:
        self._vehicle, self._dt, self._gains = declared, dt, gains or PlantGains()
        self._coeff = declared.thrust_coeff
        effect = (wrench_map(declared) / self._coeff[:, None])[:, 2:]  # thrust of each rotor to lift and torque, (4, 4)
        self._mix = np.linalg.inv(effect)
        self._velocity_integral = np.zeros((num_flights, 3))
        self._rate_integral = np.zeros((num_flights, 3))
        self._rate_before: Array | None = None
        self._rate_dot = np.zeros((num_flights, 3))

    def command(self, sample: Sample, ref: Reference, index: int) -> Array:
        """Return the rotor speeds to hold until the next call [rad/s], (F, 4)."""
        return self.rotor_speeds(sample, *self.setpoints(sample, ref, index))

    def setpoints(self, sample: Sample, ref: Reference, index: int) -> tuple[Array, Array]:
        """Return the wanted angular velocity [rad/s], body, (F, 3), and thrust per mass [m/s²], (F,)."""
        lift = self._lift_command(sample, ref, index)
        rate = self._rate_command(sample, ref, index, lift) + ref.excite[index, :, :3]
        return rate, (lift * sample.rotation[:, :, 2]).sum(axis=1) + ref.excite[index, :, 3]

    def rotor_speeds(self, sample: Sample, rate: Array, along: Array) -> Array:
        """Return the rotor speeds [rad/s], (F, 4), of a wanted angular velocity (F, 3) and thrust per mass (F,)."""
        angular = self._angular_acceleration(sample, rate)
        momentum = sample.rate @ self._vehicle.inertia
        torque = angular @ self._vehicle.inertia + row_cross_product(sample.rate, momentum)
        return self._mix_rotor_speeds(self._vehicle.mass * along, torque)

    def _lift_command(self, sample: Sample, ref: Reference, index: int) -> Array:
        """Return the wanted acceleration of thrust per mass [m/s²], world, (F, 3), within the largest tilt."""
        gains, limit = self._gains, self._gains.max_integral[0]
        target = ref.velocity[index] + gains.position * (ref.position[index] - sample.position)
        error = target - sample.velocity
        self._velocity_integral += gains.velocity_integral * self._dt * error
        self._velocity_integral = np.clip(self._velocity_integral, -limit, limit)
        lift = ref.acceleration[index] + gains.velocity * error + self._velocity_integral
        lift[:, 2] = np.maximum(lift[:, 2] + GRAVITY, 0.25 * GRAVITY)
        level = np.sqrt(lift[:, 0] ** 2 + lift[:, 1] ** 2)
        allowed = np.tan(gains.max_tilt) * lift[:, 2]
        lift[:, :2] *= np.minimum(1.0, allowed / np.maximum(level, 1e-9))[:, None]
        return lift

    def _rate_command(self, sample: Sample, ref: Reference, index: int, lift: Array) -> Array:
        """Return the wanted angular velocity [rad/s], body, (F, 3): angle error, plus the turning of the reference."""
        up, yaw = unit_rows(lift), ref.yaw[index]
        ahead = np.stack((np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)), axis=1)
        left = unit_rows(row_cross_product(up, ahead))
        wanted = np.stack((row_cross_product(left, up), left, up), axis=2)
        back = sample.rotation.transpose(0, 2, 1)
        delta = back @ wanted
        angle = 0.5 * np.stack(
            (delta[:, 2, 1] - delta[:, 1, 2], delta[:, 0, 2] - delta[:, 2, 0], delta[:, 1, 0] - delta[:, 0, 1]), axis=1
        )
        turning = row_cross_product(up, ref.jerk[index]) / np.sqrt((lift * lift).sum(axis=1, keepdims=True))
        turning = np.clip(turning, -2.0, 2.0)
        turning[:, 2] += ref.yaw_rate[index]
        return self._gains.attitude * angle + (back @ turning[:, :, None])[:, :, 0]

    def _angular_acceleration(self, sample: Sample, target: Array) -> Array:
        """Return the wanted angular acceleration [rad/s²], body, (F, 3)."""
        gains, limit = self._gains, self._gains.max_integral[1]
        error = target - sample.rate
        self._rate_integral += np.multiply(gains.rate_integral, error) * self._dt
        self._rate_integral = np.clip(self._rate_integral, -limit, limit)
        before = sample.rate if self._rate_before is None else self._rate_before
        mix = self._dt / (self._dt + gains.derivative_filter)
        self._rate_dot = self._rate_dot + mix * ((sample.rate - before) / self._dt - self._rate_dot)
        self._rate_before = sample.rate
        return gains.rate * error + self._rate_integral - gains.rate_derivative * self._rate_dot

    def _mix_rotor_speeds(self, lift: Array, torque: Array) -> Array:
        """Return rotor speeds for lift [N] (F,) and torque [N m] (F, 3); yaw yields first when a rotor saturates."""
        low, high = self._vehicle.thrust_range
        torque_yaw = torque.copy()
        torque_yaw[:, :2] = 0.0
        base = np.concatenate((lift[:, None], torque - torque_yaw), axis=1) @ self._mix
        base = np.clip(base, low, high)
        yaw = torque_yaw @ self._mix[1:]
        room = np.where(yaw > 0.0, high - base, base - low) / np.maximum(np.abs(yaw), 1e-12)
        share = np.clip(room.min(axis=1, keepdims=True), 0.0, 1.0)
        return np.sqrt((base + share * yaw) / self._coeff)
