"""How well a carefully declared vehicle is known: errors that are no effect, and what they do to a prediction.

A number of a robot file was weighed or measured once, with the standard deviations below. What they can explain is not
called an effect, and the intervals of the effects carry them. Of the same kind is what noise leaves unsure of how much the
rotors moved (``rotor_estimate``), and how much of the turning is noise that the autopilot answers (``answered_noise``): their
sizes come from each log. Letters: E environments, R rotors, N tolerances.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.robot import require_positive
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics import Vehicle
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.clock_offset import LATE_S

LAYOUT: dict[str, str | tuple[str, ...]] = {
    "mass": ("",),
    "thrust": "rotors",
    "rotor_motion": "rotors",
    **dict.fromkeys(("inertia", "com", "acc_bias", "gyro_bias", "answered_noise", "attitude"), "xyz"),
    "sensor_delay": ("rotors", "acc", "gyro", "attitude", "velocity"),
    **dict.fromkeys(("acc_scale", "imu_place"), "xyz"),
    **dict.fromkeys(("time_constant", "nominal_voltage", "command_hold", "joint_rest"), ("",)),
}
"""Tolerances in the order of their deviations, and of what: of the whole, of each rotor, about or along each axis."""

OF_LOGS = ("sensor_delay", "acc_scale", "imu_place")
"""What a logger may be off by, and no vehicle: flights tell most of it by kinematics, so that nothing hides behind it."""

STRAINED = 3.0
"""Standard deviations beyond which a declaration was not careful, or a tolerance is too small."""


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Standard deviations of what is declared, > 0."""

    mass: float = 0.003
    """Relative: a kitchen scale on a vehicle with its battery."""

    thrust: float = 0.004
    """Relative, each rotor by itself: thrust and drag torque of propellers of one type."""

    inertia: float = 0.02
    """Relative, each axis by itself: swinging or computing from parts."""

    time_constant: float = 0.03
    """Relative, all rotors together: a step on a bench."""

    com: float = 0.0003
    """Each axis [m]: balancing."""

    acc_bias: float = 0.02
    """Accelerometer, each axis [m/s²]."""

    gyro_bias: float = 0.002
    """Each axis [rad/s]."""

    acc_of_flight: float = 0.1
    """Accelerometer, each axis, anew in each flight, at most [m/s²]: it warms up by some 10 mg."""

    attitude: float = 0.01
    """Turn of the logged attitude against the body, about each axis [rad]: markers are aligned by eye, autopilots by a level.

    It turns what attitude and velocity say of forces and rates, the airspeed, and what hangs on the vehicle.
    """

    sensor_delay: float = LATE_S
    """By how much what is logged is late, rotor speeds, accelerometer, gyro, attitude and velocity each by itself [s].

    Filters, telemetry and motion capture take some milliseconds, and no logger writes them down. Commands are the clock.
    """

    acc_scale: float = 0.005
    """Relative, each axis of the accelerometer by itself: what a calibration on six sides, or one at rest, leaves."""

    imu_place: float = 0.005
    """Of the accelerometer from the origin of the body, along each axis [m]."""

    nominal_voltage: float = 0.003
    """Relative: reading a voltmeter where rotors reach the commanded speeds."""

    command_hold: float = 0.3
    """How far into the step between two rows the effective command may lie: autopilots run faster than logs are written."""

    joint_rest: float = 0.3
    """How far soft arms are from rest when a log begins, as a share of the angle at which they rest in hover."""

    def __post_init__(self) -> None:
        require_positive(self, *(field.name for field in fields(self)))

    def names(self, num_rotors: int) -> tuple[str, ...]:
        """Return the names of the N tolerances, in the order of ``LAYOUT``."""
        parts = [(name, part) for name, of in LAYOUT.items() for part in _parts_of(of, num_rotors)]
        return tuple(f"{name}_{part}" if part else name for name, part in parts)

    def strained(self, deviation: Array, *, absent: Collection[str] = (), farthest: float = np.inf) -> list[Finding]:
        """Return the deviations, of (N,) in standard deviations, that a careful declaration would not have.

        Args:
            deviation: In standard deviations.
            absent: Tolerances of what the vehicle or its logs do not have.
            farthest: Where deviations are cut off: what lies there was not measured.
        """
        names = self.names((deviation.size - len(self.names(0))) // 2)
        pairs = [
            (n, s) for n, s in zip(names, deviation.tolist(), strict=True) if abs(s) > STRAINED and n not in absent
        ]
        notes = [
            Finding("tolerance_strained", name, {"deviation_std": size}) for name, size in pairs if abs(size) < farthest
        ]
        if cut := [name for name, size in pairs if abs(size) >= farthest]:
            notes.append(Finding("tolerances_cut_off", "", {"tolerances": cut, "deviation_std": farthest}))
        return notes


def deviate(vehicle: Vehicle, tolerances: Tolerances, deviation: Tensor) -> Vehicle:
    """Return the vehicle that is off by ``deviation`` standard deviations in each tolerance.

    The inertia becomes ``S J S`` with the diagonal ``S = sqrt(1 + d)``, which stays positive definite.

    Args:
        vehicle: As declared, one environment.
        tolerances: Their sizes.
        deviation: In standard deviations, (N,), in the order of ``Tolerances.names``.
    """
    off = split(deviation)
    factor = (1.0 + tolerances.thrust * off["thrust"]).unsqueeze(0)
    stretch = (1.0 + tolerances.inertia * off["inertia"]).clamp_min(0.01).sqrt()
    slower = 1.0 + tolerances.time_constant * off["time_constant"]
    battery = vehicle.battery.clone()
    battery[:, 0] *= 1.0 + tolerances.nominal_voltage * off["nominal_voltage"]
    return replace(
        vehicle.with_scaled_maps(thrust=factor, torque=factor),
        mass=vehicle.mass * (1.0 + tolerances.mass * off["mass"]),
        inertia=vehicle.inertia * stretch.unsqueeze(-1) * stretch,
        com=vehicle.com + tolerances.com * off["com"],
        time_constant_up=vehicle.time_constant_up * slower,
        time_constant_down=vehicle.time_constant_down * slower,
        battery=battery,
    )


@dataclass(frozen=True, kw_only=True)
class Deviated:
    """What is flown where deviations within the tolerances are given."""

    vehicle: Vehicle
    """One environment."""

    command_shift: float
    """How far the effective command lies towards the next row, in steps."""

    joint_start: float
    """Angle of soft arms when a log begins, as a share of the one at which they would rest."""


def deviated(declared: Vehicle, tolerances: Tolerances, deviation: Array | None) -> Deviated:
    """Return what is flown with deviations (N,), in standard deviations; None: exactly what is declared."""
    if deviation is None:
        return Deviated(vehicle=declared, command_shift=0.0, joint_start=1.0)
    off = torch.from_numpy(deviation)
    return Deviated(
        vehicle=deviate(declared, tolerances, off),
        command_shift=command_shift(tolerances, off),
        joint_start=joint_start(tolerances, off),
    )


@dataclass(frozen=True, kw_only=True)
class Sensed:
    """What deviations do to what is logged of a vehicle."""

    acc_bias: Tensor
    """[m/s²], body, (3,)."""

    gyro_bias: Tensor
    """[rad/s], body, (3,)."""

    acc_scale: Tensor
    """Relative, (3,)."""

    imu_place: Tensor
    """Of the accelerometer from the origin of the body [m], body, (3,)."""

    rotor_motion: Tensor
    """How much more the rotors moved in each of their modes than is expected, in standard deviations of that, (R,)."""

    answered_noise: Tensor
    """How much of the turning about each axis is noise in step with the torque, in standard deviations, (3,)."""

    attitude: Tensor
    """Roll, pitch and yaw from the axes of the logged attitude to those of the body [rad], (3,)."""

    delays: Tensor
    """Of rotor speeds, accelerometer, gyro, attitude and velocity [s], (5,)."""

    @property
    def turn(self) -> Tensor:
        """Rotation from the axes of the logged attitude to those of the body, (4,)."""
        return quat_from_euler(self.attitude)

    @property
    def key(self) -> bytes:
        """What tells it from others."""
        numbers = torch.cat([getattr(self, field.name) for field in fields(self)])
        return numbers.numpy().tobytes() if numbers.any() else b""


def sensed(tolerances: Tolerances, deviation: Tensor) -> Sensed:
    """Return what deviations (N,), in standard deviations, do to what is logged."""
    off = split(deviation)
    return Sensed(
        acc_bias=tolerances.acc_bias * off["acc_bias"],
        gyro_bias=tolerances.gyro_bias * off["gyro_bias"],
        acc_scale=tolerances.acc_scale * off["acc_scale"],
        imu_place=tolerances.imu_place * off["imu_place"],
        rotor_motion=off["rotor_motion"],
        answered_noise=off["answered_noise"],
        attitude=tolerances.attitude * off["attitude"],
        delays=tolerances.sensor_delay * off["sensor_delay"],
    )


def command_shift(tolerances: Tolerances, deviation: Tensor) -> float:
    """Return how far the effective command lies towards the next row, in steps; 0: held from its row on."""
    return float(tolerances.command_hold * split(deviation)["command_hold"])


def joint_start(tolerances: Tolerances, deviation: Tensor) -> float:
    """Return the angle of soft arms when a log begins as a share of the one at which they would rest."""
    return float(1.0 + tolerances.joint_rest * split(deviation)["joint_rest"])


def split(deviation: Tensor) -> dict[str, Tensor]:
    """Return the parts of deviations (N,) by the names of ``LAYOUT``."""
    return dict(zip(LAYOUT, torch.split(deviation, _sizes(deviation.numel())), strict=True))


@cache
def _sizes(number: int) -> list[int]:
    """Return how many of a number N of tolerances each name of ``LAYOUT`` has."""
    none = {name: len(_parts_of(of, 0)) for name, of in LAYOUT.items()}
    rotors = (number - sum(none.values())) // sum(of == "rotors" for of in LAYOUT.values())
    return [len(_parts_of(of, rotors)) for of in LAYOUT.values()]


def of_logs(num_rotors: int) -> Flags:
    """Return which of the N tolerances belong to logs alone, (N,)."""
    return np.array([name in OF_LOGS for name, of in LAYOUT.items() for _ in _parts_of(of, num_rotors)])


def _parts_of(of: Iterable[str], num_rotors: int) -> list[str]:
    """Return the names of what a tolerance is of."""
    return [str(number + 1) for number in range(num_rotors)] if of == "rotors" else list(of)
