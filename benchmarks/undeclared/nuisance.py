"""Small errors that every real vehicle has: nothing that an identification should call an effect."""

from collections.abc import Container
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.undeclared.vehicle import Array, PlantVehicle


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


TRACKED = PlantNuisance(attitude=0.01, acc_of_flight=0.05)
"""As logs of a motion-capture room have it beside: markers that are aligned by eye, an accelerometer that warms up."""

LOGGED = replace(TRACKED, delay=0.003, acc_scale=0.005, imu_place=0.005)
"""And as loggers write it: filters and telemetry take time, an accelerometer has a scale and a place."""

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
    bias = Bias(acc=acc, gyro=gyro, attitude=attitude, delay=delay, acc_scale=scale, imu_place=place)
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
