"""How well a carefully declared vehicle is known: errors that are no effect, and what they do to a prediction.

A number of a robot file was weighed or measured once, with the standard deviations below. What they can explain is not
called an effect, and the intervals of the effects carry them. Of the same kind is what noise leaves unsure of how much the
rotors moved (``rotor_estimate``), and how much of the turning is noise that the autopilot answers (``answered_noise``): their
sizes come from each log. Letters: E environments, R rotors, N tolerances.
"""

from collections.abc import Collection
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.robot import require_positive
from aerial_gym.math.quaternion import quat_from_euler, quat_to_matrix
from aerial_gym.physics import Vehicle

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

    nominal_voltage: float = 0.003
    """Relative: reading a voltmeter where rotors reach the commanded speeds."""

    command_hold: float = 0.3
    """How far into the step between two rows the effective command may lie: autopilots run faster than logs are written."""

    joint_rest: float = 0.3
    """How far soft arms are from rest when a log begins, as a share of the angle at which they rest in hover."""

    def __post_init__(self) -> None:
        require_positive(self, *(field.name for field in fields(self)))

    def names(self, num_rotors: int) -> tuple[str, ...]:
        """Return the names of the N tolerances, in the order of ``Deviation``."""
        rotors = [f"{name}_{number}" for name in ("thrust", "rotor_motion") for number in range(1, num_rotors + 1)]
        of_axes = ("inertia", "com", "acc_bias", "gyro_bias", "answered_noise", "attitude")
        axes = [f"{name}_{axis}" for name in of_axes for axis in "xyz"]
        return ("mass", *rotors, *axes, "time_constant", "nominal_voltage", "command_hold", "joint_rest")

    def strained(
        self, deviation: NDArray[np.float64], *, absent: Collection[str] = (), farthest: float = np.inf
    ) -> list[str]:
        """Return a note for each of the (N,) deviations, in standard deviations, that a careful declaration would not have.

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
            f"beside the named effects the flights ask for {name} to be off by {size:+.1f} standard deviations of its "
            f"tolerance: {self._way_out(name)}"
            for name, size in pairs
            if abs(size) < farthest
        ]
        if cut := [name for name, size in pairs if abs(size) >= farthest]:
            notes.append(
                f"{', '.join(cut)}: cut off at {farthest:g} standard deviations of the tolerance, and so no measurement: "
                "something else is missing, or noise of the inputs looks like it"
            )
        return notes

    def _way_out(self, name: str) -> str:
        known = "give the tolerance that it has (--tolerances)"
        if name.startswith(("acc_bias", "gyro_bias")):
            return f"calibrate it, or {known}"
        if name.startswith("attitude"):
            return f"align the logged attitude with the body, or {known}"
        if name.startswith("rotor_motion"):
            return "the noise of the logged rotor speeds hides how much they moved; log commands, or fly more"
        if name.startswith("answered_noise"):
            return "torque and noise of the gyro go together, or something else is missing; fly more than hover"
        return known if name in ("command_hold", "joint_rest") else f"declare it anew, or {known}"


def deviate(vehicle: Vehicle, tolerances: Tolerances, deviation: Tensor) -> Vehicle:
    """Return the vehicle that is off by ``deviation`` standard deviations in each tolerance.

    The inertia becomes ``S J S`` with the diagonal ``S = sqrt(1 + d)``, which stays positive definite.

    Args:
        vehicle: As declared, one environment.
        tolerances: Their sizes.
        deviation: In standard deviations, (N,), in the order of ``Tolerances.names``.
    """
    mass, rotors, _, inertia, com, _, _, _, _, lag, voltage, _, _ = _parts(deviation)
    factor = (1.0 + tolerances.thrust * rotors).unsqueeze(0)
    stretch = (1.0 + tolerances.inertia * inertia).clamp_min(0.01).sqrt()
    slower = 1.0 + tolerances.time_constant * lag
    battery = vehicle.battery.clone()
    battery[:, 0] *= 1.0 + tolerances.nominal_voltage * voltage
    return replace(
        vehicle.with_scaled_maps(thrust=factor, torque=factor),
        mass=vehicle.mass * (1.0 + tolerances.mass * mass),
        inertia=vehicle.inertia * stretch.unsqueeze(-1) * stretch,
        com=vehicle.com + tolerances.com * com,
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


def deviated(declared: Vehicle, tolerances: Tolerances, deviation: NDArray[np.float64] | None) -> Deviated:
    """Return what is flown with deviations (N,), in standard deviations; None: exactly what is declared."""
    if deviation is None:
        return Deviated(vehicle=declared, command_shift=0.0, joint_start=1.0)
    off = torch.from_numpy(deviation)
    return Deviated(
        vehicle=deviate(declared, tolerances, off),
        command_shift=command_shift(tolerances, off),
        joint_start=joint_start(tolerances, off),
    )


def sensor_biases(tolerances: Tolerances, deviation: Tensor) -> tuple[Tensor, Tensor]:
    """Return the biases of accelerometer [m/s²] and gyro [rad/s], body, each (3,)."""
    *_, acc, gyro, _, _, _, _, _, _ = _parts(deviation)
    return tolerances.acc_bias * acc, tolerances.gyro_bias * gyro


def command_shift(tolerances: Tolerances, deviation: Tensor) -> float:
    """Return how far the effective command lies towards the next row, in steps; 0: held from its row on."""
    return float(tolerances.command_hold * deviation[-2])


def joint_start(tolerances: Tolerances, deviation: Tensor) -> float:
    """Return the angle of soft arms when a log begins as a share of the one at which they would rest."""
    return float(1.0 + tolerances.joint_rest * deviation[-1])


def rotor_motion(deviation: Tensor) -> Tensor:
    """Return how much more the rotors moved in each of their modes than is expected, in standard deviations of that, (R,)."""
    return _parts(deviation)[2]


def answered_noise(deviation: Tensor) -> Tensor:
    """Return how much of the turning about each axis is noise in step with the torque, in standard deviations, (3,)."""
    return _parts(deviation)[7]


def attitude_turn(tolerances: Tolerances, deviation: Tensor) -> Tensor:
    """Return the matrix that turns the axes of the logged attitude into those of the body, (3, 3)."""
    return quat_to_matrix(attitude_error(tolerances, deviation))


def attitude_error(tolerances: Tolerances, deviation: Tensor) -> Tensor:
    """Return the rotation from the axes of the logged attitude to those of the body, (4,)."""
    return quat_from_euler(tolerances.attitude * turned(deviation))


def turned(deviation: Tensor) -> Tensor:
    """Return how far the logged attitude is turned about each axis, in standard deviations, (3,)."""
    return _parts(deviation)[8]


def _parts(deviation: Tensor) -> tuple[Tensor, ...]:
    """Return the deviations of mass, thrust, rotor motion, inertia, com, biases, noise, attitude and each of the others."""
    others = [3, 3, 3, 3, 3, 3, 1, 1, 1, 1]
    rotors = (deviation.numel() - 1 - sum(others)) // 2
    return torch.split(deviation, [1, rotors, rotors, *others])
