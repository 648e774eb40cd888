"""Small errors that every real vehicle has, sensor noise, and one sample of all sensors.

The autopilot flies on the same noisy samples that are logged, so that command and noise are correlated as on a real
vehicle. Letters: F flights, T samples.
"""

from collections.abc import Container
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.undeclared.dynamics import RATE, ROTOR, Plant, cross_matrix, rotation_matrices
from benchmarks.undeclared.vehicle import NEUTRAL, Array, Extra, PlantVehicle


@dataclass(frozen=True, kw_only=True)
class PlantNuisance:
    """Standard deviations; draws are normal, cut at two of them."""

    mass: float = 0.003  # Relative
    thrust_coeff: float = 0.004  # Relative, each rotor by itself
    inertia: float = 0.02  # Relative, each axis by itself
    tau: float = 0.03  # Relative, one factor for up and down
    com: float = 0.0003  # Each axis [m]
    acc_bias: float = 0.02  # Each axis [m/s²]
    gyro_bias: float = 0.002  # Each axis [rad/s]
    attitude: float = 0.0  # Turn of the logged attitude against the body, each axis [rad]
    acc_of_flight: float = 0.0  # Accelerometer, each axis, beside its bias, anew for each flight [m/s²]

    delay: float = 0.0
    """Rotor speeds, accelerometer, gyro, pose and velocity, each by itself, late in the log, or early [s]."""

    acc_scale: float = 0.0  # Accelerometer, each axis, relative
    imu_place: float = 0.0  # Accelerometer from the origin of the body, each axis [m]
    velocity_place: float = 0.0  # Point whose position and velocity are logged, from the body origin, each axis [m]


TRACKED = PlantNuisance(attitude=0.01, acc_of_flight=0.05)
"""As logs of a motion-capture room have it beside: markers that are aligned by eye, an accelerometer that warms up."""

LOGGED = replace(TRACKED, delay=0.003, acc_scale=0.005, imu_place=0.005, velocity_place=0.005)
"""Also errors of loggers: delays by filters and telemetry, scale and place of the accelerometer, place of the velocity."""

LATE = ("rotor", "acc", "rate", "rotation", "velocity")  # What is late by itself; the position is with the rotation


@dataclass(frozen=True, kw_only=True)
class Bias:
    """Constant sensor errors, body frame."""

    acc: Array  # Accelerometer [m/s²], (3,) of the whole case or (F, 3) of each flight
    gyro: Array  # Gyro [rad/s], (3,)
    attitude: Array  # Rotation vector that turns the axes of the logged attitude into those of the body [rad], (3,)
    acc_scale: Array = field(default_factory=lambda: np.zeros(3))  # Of the accelerometer, relative, (3,)

    imu_place: Array = field(default_factory=lambda: np.zeros(3))
    """Of the accelerometer from the origin of the body [m], (3,)."""

    velocity_place: Array = field(default_factory=lambda: np.zeros(3))
    """Point whose position and velocity are logged, from the body origin [m], (3,)."""

    delay: Array = field(default_factory=lambda: np.zeros(len(LATE)))
    """By how much each of ``LATE`` is late in the log [s]."""


NO_BIAS = Bias(acc=np.zeros(3), gyro=np.zeros(3), attitude=np.zeros(3))


STATED_LAG = ("motor_time_constant", "motor_asymmetry")
"""Hidden effects that state the lag itself, in place of the declared one."""


def add_nuisance(
    true: PlantVehicle, cfg: PlantNuisance, *, seed: int, hidden: Container[str] = (), num_flights: int = 1
) -> tuple[PlantVehicle, Bias]:
    """Return the vehicle with small errors besides the hidden effects, and the sensor biases.

    What a case states of its hidden effects is without them, as a scale or a bench would find it on a perfectly declared
    vehicle; but a hidden lag is stated whole, in seconds, and is what it says (``STATED_LAG``). The inertia becomes ``S I S``
    with a diagonal S, which stays positive definite.
    """
    rng = np.random.default_rng([seed, 2])

    def draw(std: float, *shape: int) -> Array:
        return std * np.clip(rng.standard_normal(shape), -2.0, 2.0)

    mass, coeff, inertia = draw(cfg.mass, 1), draw(cfg.thrust_coeff, 4), draw(cfg.inertia, 3)
    tau, com = draw(cfg.tau, 1), draw(cfg.com, 3)
    acc, gyro, attitude = draw(cfg.acc_bias, 3), draw(cfg.gyro_bias, 3), draw(cfg.attitude, 3)
    if cfg.acc_of_flight:
        acc = acc + draw(cfg.acc_of_flight, num_flights, 3)
    delay, scale, place = draw(cfg.delay, len(LATE)), draw(cfg.acc_scale, 3), draw(cfg.imu_place, 3)
    errors = {"delay": delay, "acc_scale": scale, "imu_place": place, "velocity_place": draw(cfg.velocity_place, 3)}
    bias = Bias(acc=acc, gyro=gyro, attitude=attitude, **errors)
    stretch = np.sqrt(1.0 + inertia)
    factor = 1.0 if any(name in hidden for name in STATED_LAG) else 1.0 + float(tau[0])
    vehicle = replace(
        true,
        mass=true.mass * (1.0 + float(mass[0])),
        thrust_coeff=true.thrust_coeff * (1.0 + coeff),
        inertia=true.inertia * np.outer(stretch, stretch),
        tau_up=true.tau_up * factor,
        tau_down=true.tau_down * factor,
        com=true.com + com,
    )
    return vehicle, bias


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

    position: Array  # Body origin, or the point of ``Bias.velocity_place`` [m], world, (F, 3)
    velocity: Array  # Velocity of that point [m/s], world, (F, 3)
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
        if any(extra.tracked_turn):
            self._aligned = self._aligned @ Rotation.from_euler("xyz", extra.tracked_turn).as_matrix()
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
        turn, place = rotation_matrices(state), self._bias.velocity_place
        lever = np.cross(state[:, RATE], place)
        return Sample(
            position=plant.origin_position(state) + turn @ place + draw[:, 0:3],
            velocity=plant.origin_velocity(state) + np.einsum("fij,fj->fi", turn, lever) + draw[:, 3:6],
            rotation=turn @ (np.eye(3) + cross_matrix(draw[:, 6:9])) @ self._aligned,
            rate=rate + draw[:, 9:12] + self._bias.gyro,
            acc=acc + draw[:, 12:15] + self._bias.acc,
            rotor=self._rotor_reading * state[:, ROTOR] * (1.0 + draw[:, 15:19]),
        )
