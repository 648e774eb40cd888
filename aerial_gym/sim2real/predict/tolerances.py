"""Tolerances of a carefully declared vehicle, and the prediction errors that they cause.

Each number of a robot file was measured with the standard deviations below. Errors that these can explain are not called
effects, and the intervals of effects include them. Two tolerances come from each log: the uncertain rotor motion
(``rotor_estimate``) and the noise that feedback correlates with torque (``answered_noise``). Letters: E environments,
R rotors, N tolerances.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.checks import require_not_negative, require_positive
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics import Vehicle
from aerial_gym.physics.effects.vehicle_errors import add_products
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import LATE_S, Recording

LAYOUT: dict[str, str | tuple[str, ...]] = {
    "mass": ("",),
    "thrust": "rotors",
    "rotor_motion": "rotors",
    **dict.fromkeys(("inertia", "com", "acc_bias", "gyro_bias"), "xyz"),
    "answered_noise": ("x", "y", "z", "late_x", "late_y", "late_z"),
    "attitude": "xyz",
    "sensor_delay": ("rotors", "acc", "gyro", "attitude", "velocity"),
    **dict.fromkeys(("acc_scale", "imu_place"), "xyz"),
    **dict.fromkeys(("time_constant", "nominal_voltage", "command_hold", "joint_rest"), ("",)),
    **dict.fromkeys(("command_clock", "command_gain"), ("",)),
    "products": ("xy", "xz", "yz"),
    **dict.fromkeys(("velocity_place", "gyro_scale", "attitude_scale", "velocity_scale", "load_place"), "xyz"),
}
"""Names of the tolerances in order, with their parts: one for all, one per rotor, or one per axis or sensor."""

SCALES = ("acc_scale", "gyro_scale", "attitude_scale", "velocity_scale")
OF_LOGS = ("sensor_delay", *SCALES, "imu_place", "command_clock", "command_gain", "velocity_place")
"""Tolerances of the logger, which hide no effect."""

OF_COMMANDS = ("command_clock", "command_gain")  # Exact unless the log leaves them open
UNKNOWN_GAIN = 0.15  # Of commands whose scale comes from the log: 30 % of the thrust

STRAINED = 3.0  # Standard deviations beyond which a declaration is implausible, or its tolerance too small


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Standard deviations of declared values, > 0; those of commands may be 0."""

    mass: float = 0.003  # Relative; by a kitchen scale, with battery
    thrust: float = 0.004  # Relative, independent per rotor; thrust and drag torque of propellers of one type
    inertia: float = 0.02  # Relative, independent per axis; by a swing test or computed from parts
    products: float = 0.005  # Products of inertia per root of their two moments; principal axes within half a degree
    time_constant: float = 0.03  # Relative, common to all rotors; by a step on a test stand
    com: float = 0.0003  # Per axis [m]; by balancing
    acc_bias: float = 0.02  # Accelerometer bias per axis [m/s²]
    gyro_bias: float = 0.002  # Gyro bias per axis [rad/s]
    acc_of_flight: float = 0.1  # Largest accelerometer bias of a single flight, per axis [m/s²]: some 10 mg warming up
    attitude: float = 0.01  # Misalignment of the logged attitude about each axis [rad], aligned by eye or level
    sensor_delay: float = LATE_S  # Delay of rotor speeds, accelerometer, gyro, attitude, velocity, each [s]
    acc_scale: float = 0.005  # Relative accelerometer scale per axis, after a calibration on six sides or at rest
    imu_place: float = 0.005  # Accelerometer position relative to the body origin, per axis [m]
    velocity_place: float = (
        0.005  # Point whose velocity is logged, per axis [m]; an estimator may take its accelerometer's
    )
    gyro_scale: float = 0.015  # Relative, per axis; half the limit of InvenSense's MPU-6000 (rev. 3.4, section 6.1)
    attitude_scale: float = 0.015  # Relative, of the attitude's turning per body axis: estimators integrate a gyro
    velocity_scale: float = 0.01  # Relative scale of the logged velocity per world axis, as of a camera's depth
    nominal_voltage: float = 0.003  # Relative; battery voltage at which rotors reach the commanded speed
    command_hold: float = 0.3  # Shift of the command towards the next row, in rows: autopilots are faster than logs
    joint_rest: float = 0.3  # Initial deviation of soft arms from rest, as a share of their hover angle
    command_clock: float = 0.0  # Common delay of all sensors behind the commands [s], unknown after a move of their log
    command_gain: float = 0.0  # Relative scale of commands whose largest value the log does not state
    load_place: float = 0.01  # Hook of a slung load relative to the body origin, per axis [m]

    def __post_init__(self) -> None:
        require_positive(self, *(field.name for field in fields(self) if field.name not in OF_COMMANDS))
        require_not_negative(self, *OF_COMMANDS)

    def names(self, num_rotors: int) -> tuple[str, ...]:
        """Return the names of the N tolerances in the order of ``LAYOUT``."""
        parts = [(name, part) for name, of in LAYOUT.items() for part in _part_names(of, num_rotors)]
        return tuple(f"{name}_{part}" if part else name for name, part in parts)

    def standard_deviations(self, num_rotors: int) -> Array:
        """Return the standard deviations of the N tolerances, (N,); 0 for those that come from each log."""
        return np.array([getattr(self, name, 0.0) for name, of in LAYOUT.items() for _ in _part_names(of, num_rotors)])

    def implausible_deviations(
        self, deviation: Array, *, absent: Collection[str] = (), farthest: float = np.inf
    ) -> list[Finding]:
        """Return findings on implausible deviations (N,) but ``absent`` ones; the fit cut off those at ``farthest``."""
        names = self.names((deviation.size - len(self.names(0))) // 2)
        pairs = [(n, s) for n, s in zip(names, deviation.tolist(), strict=True) if abs(s) > STRAINED]
        pairs = [(name, size) for name, size in pairs if name not in absent]
        weak = [(name, size) for name, size in pairs if abs(size) < farthest]
        notes = [Finding("tolerance_strained", name, {"deviation_std": size}) for name, size in weak]
        if cut := [name for name, size in pairs if abs(size) >= farthest]:
            notes.append(Finding("tolerances_cut_off", "", {"tolerances": cut, "deviation_std": farthest}))
        return notes


def tolerances_after_move(tolerances: Tolerances, notes: Iterable[Finding]) -> Tolerances:
    """Return the tolerances with a command clock as unsure as the largest move of commands with a rotor log.

    Two independently delayed sensors look like such a clock, and the speeds alone may be late. So the move may be wrong by
    its whole size; its direction imitates or hides a dead time.
    """
    leads = [
        abs(float(n.values["lead_ms"])) for n in notes if n.code == "rotor_log_moved" and n.values["with_commands"]
    ]
    return replace(tolerances, command_clock=max([tolerances.command_clock, *(1e-3 * lead for lead in leads)]))


def tolerances_after_scaling(tolerances: Tolerances, flights: Sequence[Flight]) -> Tolerances:
    """Return the tolerances with an unknown gain of commands if the measurements scale them in all flights.

    A scale by thrust assumes the declared mass and thrust, and a load that hangs below changes it. One by measured speeds
    has the error of that fit, which is common to all rotors: a gain of one rotor beside an error of its sensor imitates it.
    """
    scaled = bool(flights) and all(_scaling_notes(flight) for flight in flights)
    gain = UNKNOWN_GAIN if scaled else 0.0
    return replace(tolerances, command_gain=max(tolerances.command_gain, gain))


def are_scaled_by_thrust(flights: Sequence[Recording]) -> bool:
    """Return whether the commands of all flights, without rotor speeds, are scaled by their mean measured thrust."""

    def is_scaled(flight: Recording) -> bool:
        return flight.rotor_speed is None and not all(note.values.get("by_speeds") for note in _scaling_notes(flight))

    return bool(flights) and all(map(is_scaled, flights))


def _scaling_notes(flight: Recording) -> list[Finding]:
    """Return the findings on commands that measurements scale."""
    return [note for note in flight.notes if note.code in ("commands_scaled", "relative_commands_scaled")]


def tolerances_after_gains(tolerances: Tolerances, flights: Sequence[Sequence[Finding]]) -> Tolerances:
    """Return the tolerances with scales as unsure as the gains that half of the flights contradict (``sensor_gain``).

    Kinematics then determine the scale, so that no effect stands in for it. Either sensor of a pair may be wrong.
    """

    def median_error(column: str) -> float:
        gains = [[one.values for one in notes if one.code == "sensor_gain"] for notes in flights]
        errors = [[abs(g["gain_ratio"] - 1.0) for g in own if g["column"].startswith(column)] for own in gains]
        return float(np.median([max(own, default=0.0) for own in errors]))

    turning, force = median_error("omega"), median_error("acc")
    errors = dict(zip(SCALES, (force, turning, turning, force), strict=True))
    return replace(tolerances, **{name: max(getattr(tolerances, name), error) for name, error in errors.items()})


def vehicle_with_deviations(vehicle: Vehicle, tolerances: Tolerances, deviation: Tensor) -> Vehicle:
    """Return the vehicle with a deviation (N,) in standard deviations: inertia ``S J S``, S = sqrt(1 + d), plus products."""
    off = split_deviations(deviation)
    factor = (1.0 + tolerances.thrust * off["thrust"]).unsqueeze(0)
    stretch = (1.0 + tolerances.inertia * off["inertia"]).clamp_min(0.01).sqrt()
    products = (tolerances.products * off["products"]).expand(len(vehicle.mass), 3)
    slower = 1.0 + tolerances.time_constant * off["time_constant"]
    battery = vehicle.battery.clone()
    battery[:, 0] *= 1.0 + tolerances.nominal_voltage * off["nominal_voltage"]
    return replace(
        vehicle.with_scaled_maps(thrust=factor, torque=factor),
        mass=vehicle.mass * (1.0 + tolerances.mass * off["mass"]),
        inertia=add_products(vehicle.inertia * stretch.unsqueeze(-1) * stretch, products),
        com=vehicle.com + tolerances.com * off["com"],
        time_constant_up=vehicle.time_constant_up * slower,
        time_constant_down=vehicle.time_constant_down * slower,
        battery=battery,
    )


@dataclass(frozen=True, kw_only=True)
class VehicleForReplay:
    """Vehicle and replay settings with deviations within the tolerances."""

    vehicle: Vehicle  # One environment
    command_shift: float = 0.0  # Shift of the effective command towards the next row, in rows
    joint_start: float = 1.0  # Initial angle of soft arms as a share of their rest angle
    command_gain: float = 1.0  # Factor on the commands
    load_place: Tensor = field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    """Hook of a slung load relative to the body origin [m], body, (3,)."""


def vehicle_for_replay(declared: Vehicle, tolerances: Tolerances, deviation: Array | None) -> VehicleForReplay:
    """Return vehicle and replay settings for deviations (N,) in standard deviations; None: exactly as declared."""
    if deviation is None:
        return VehicleForReplay(vehicle=declared)
    numbers = torch.from_numpy(deviation)
    off = split_deviations(numbers)
    return VehicleForReplay(
        vehicle=vehicle_with_deviations(declared, tolerances, numbers),
        command_shift=float(tolerances.command_hold * off["command_hold"]),
        joint_start=float(1.0 + tolerances.joint_rest * off["joint_rest"]),
        command_gain=float(1.0 + tolerances.command_gain * off["command_gain"]),
        load_place=tolerances.load_place * off["load_place"],
    )


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Sensor errors of a vehicle's log for given deviations."""

    acc_bias: Tensor  # [m/s²], body, (3,)
    gyro_bias: Tensor  # [rad/s], body, (3,)
    acc_scale: Tensor  # Relative, (3,)
    imu_place: Tensor  # Accelerometer position relative to the body origin [m], body, (3,)
    gyro_scale: Tensor  # Relative, (3,)
    attitude_scale: Tensor  # Relative, (3,)
    velocity_scale: Tensor  # Relative, world axes, (3,)
    velocity_place: Tensor  # Point whose velocity is logged, relative to the body origin [m], body, (3,)
    rotor_motion: Tensor  # Deviation of the motion in each rotor mode, in its standard deviations, (R,)
    answered_noise: Tensor  # Deviation of noise correlated with torque, then a quarter period late, in its std, (6,)
    attitude: Tensor  # Roll, pitch and yaw from the axes of the logged attitude to those of the body [rad], (3,)
    delays: Tensor  # Delays of rotor speeds, accelerometer, gyro, attitude and velocity [s], (5,)

    @property
    def attitude_turn(self) -> Tensor:
        """Quaternion from the axes of the logged attitude to those of the body, (4,)."""
        return quat_from_euler(self.attitude)

    @property
    def key(self) -> bytes:
        """Hashable key; empty without any error."""
        numbers = torch.cat([getattr(self, field.name) for field in fields(self)])
        return numbers.numpy().tobytes() if numbers.any() else b""


def sensor_errors(tolerances: Tolerances, deviation: Tensor) -> SensorErrors:
    """Return the sensor errors of deviations (N,) in standard deviations."""
    off = split_deviations(deviation)
    names = ("acc_bias", "gyro_bias", *SCALES, "imu_place", "velocity_place", "attitude")
    return SensorErrors(
        **{name: getattr(tolerances, name) * off[name] for name in names},
        rotor_motion=off["rotor_motion"],
        answered_noise=off["answered_noise"],
        delays=tolerances.sensor_delay * off["sensor_delay"] + tolerances.command_clock * off["command_clock"],
    )


def split_deviations(deviation: Tensor) -> dict[str, Tensor]:
    """Return the parts of deviations (N,) by the names of ``LAYOUT``."""
    return dict(zip(LAYOUT, torch.split(deviation, _part_counts(deviation.numel())), strict=True))


@cache
def _part_counts(number: int) -> list[int]:
    """Return the number of parts of each name of ``LAYOUT``, for N tolerances in total."""
    none = {name: len(_part_names(of, 0)) for name, of in LAYOUT.items()}
    rotors = (number - sum(none.values())) // sum(of == "rotors" for of in LAYOUT.values())
    return [len(_part_names(of, rotors)) for of in LAYOUT.values()]


def is_tolerance_of_logs(num_rotors: int) -> Flags:
    """Return the flags of the N tolerances that belong to logs alone, (N,)."""
    return np.array([name in OF_LOGS for name, of in LAYOUT.items() for _ in _part_names(of, num_rotors)])


def _part_names(of: Iterable[str], num_rotors: int) -> list[str]:
    """Return the names of a tolerance's parts."""
    return [str(number + 1) for number in range(num_rotors)] if of == "rotors" else list(of)
