"""Sensor noise, and one sample of all sensors.

The autopilot flies on the same noisy samples that are logged, so that command and noise are correlated as on a real
vehicle. Letters: F flights, T samples.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.undeclared.dynamics import RATE, ROTOR, Plant, cross_matrix, rotation_matrices
from benchmarks.undeclared.nuisance import Bias
from benchmarks.undeclared.vehicle import NEUTRAL, Array, Extra


@dataclass(frozen=True, kw_only=True)
class PlantNoise:
    """Standard deviation of the white noise of one sample, each axis."""

    acc: float = 0.07  # Accelerometer [m/s²]
    gyro: float = 0.003  # Gyro [rad/s]
    attitude: float = float(np.deg2rad(0.05))  # Rotation vector of the attitude error, body frame [rad]
    position: float = 0.001  # Position [m]
    velocity: float = 0.005  # Velocity [m/s]
    rotor: float = 0.003  # Rotor speed, relative


NOISELESS = PlantNoise(acc=0.0, gyro=0.0, attitude=0.0, position=0.0, velocity=0.0, rotor=0.0)


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Readings of all sensors at one instant."""

    position: Array  # Body origin [m], world, (F, 3)
    velocity: Array  # Of the body origin [m/s], world, (F, 3)
    rotation: Array  # Tracked axes, those of the body but for how they are aligned, to world, (F, 3, 3)
    rate: Array  # Angular velocity [rad/s], IMU axes, (F, 3)
    acc: Array  # Specific force where the accelerometer is [m/s²], IMU axes, (F, 3)
    rotor: Array  # Rotor speeds [rad/s], (F, 4)


class PlantSensors:
    """Draws the noise of all flights at construction, each flight from its own generator."""

    def __init__(
        self,
        noise: PlantNoise,
        bias: Bias,
        generators: list[np.random.Generator],
        num_samples: int,
        *,
        extra: Extra = NEUTRAL,
    ) -> None:
        self._bias = replace(bias, acc=bias.acc + extra.imu_bias[:3], gyro=bias.gyro + extra.imu_bias[3:])
        self._aligned = Rotation.from_rotvec(bias.attitude).as_matrix()
        self._turn = Rotation.from_euler("xyz", extra.imu_turn).as_matrix() if any(extra.imu_turn) else None
        self._rotor_reading = extra.rotor_reading
        scale = (noise.position, noise.velocity, noise.attitude, noise.gyro, noise.acc)
        scale19 = np.concatenate((np.repeat(scale, 3), np.full(4, noise.rotor)))
        self._draws = np.stack([rng.standard_normal((num_samples, 19)) for rng in generators], axis=1) * scale19

    def sample(self, index: int, plant: Plant, state: Array) -> Sample:
        """Return sample ``index`` of every flight, for states (F, 22)."""
        draw, rate, acc = self._draws[index], state[:, RATE], plant.specific_force(state, self._bias.imu_place)
        if self._turn is not None:
            rate, acc = rate @ self._turn, acc @ self._turn
        acc = (1.0 + self._bias.acc_scale) * acc
        return Sample(
            position=plant.origin_position(state) + draw[:, 0:3],
            velocity=plant.origin_velocity(state) + draw[:, 3:6],
            rotation=rotation_matrices(state) @ (np.eye(3) + cross_matrix(draw[:, 6:9])) @ self._aligned,
            rate=rate + draw[:, 9:12] + self._bias.gyro,
            acc=acc + draw[:, 12:15] + self._bias.acc,
            rotor=self._rotor_reading * state[:, ROTOR] * (1.0 + draw[:, 15:19]),
        )
