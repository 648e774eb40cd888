"""A checked flight with a complete state in every row: what is missing in the log is derived where that is sound.

Letters: T rows, R rotors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.model import STANDARD_GRAVITY
from aerial_gym.physics.rotors import evaluate_map, rotor_wrench
from aerial_gym.sim2real.checks import body_rate_of, check_log, check_quaternion_norm, rate_of
from aerial_gym.sim2real.flight_log import FlightLog, read_flight_log
from aerial_gym.sim2real.held import mend_holds
from aerial_gym.sim2real.mapping import LogMapping
from aerial_gym.sim2real.signals import lowpass, rotor_log_lead, shift_rotor_log, uniform_log

Array = NDArray[np.float64]

DERIVED_BAND = 0.2
"""Derivatives that stand in for a missing sensor are low-passed at this share of the rate."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """One flight at equal time steps; world ENU, body FLU, SI."""

    name: str
    """Short name, unique among the flights of one run."""

    path: str
    """File."""

    rate: float
    """Rows per second [Hz]."""

    time: Array
    """[s], (T,)."""

    position: Array | None
    """[m], (T, 3)."""

    attitude: Array
    """Body to world, unit, xyzw, no jumps of sign, (T, 4)."""

    lin_vel: Array | None
    """[m/s], world, (T, 3)."""

    ang_vel: Array
    """[rad/s], body, (T, 3)."""

    attitude_integrated: bool
    """Whether ``attitude`` is that which the gyro implies."""

    gyro: bool
    """Whether ``ang_vel`` was measured and the rotors' torques are known; if not, its derivative is no channel."""

    specific_force: Array | None
    """[m/s²], body, (T, 3)."""

    accelerometer: bool
    """Whether ``specific_force`` was measured; if not, it was derived from the velocity."""

    rotor_speed: Array | None
    """Measured [rad/s], (T, R)."""

    rotor_command: Array | None
    """[rad/s], (T, R)."""

    notes: tuple[str, ...]
    """What was done to the log."""

    battery: Array | None = None
    """Voltage [V], (T,)."""

    other_position: Array | None = None
    """Body origin of another vehicle flown at the same time [m], world, (T, 3); NaN where it is not known."""

    ground_height: float = 0.0
    """World z of the ground [m]."""

    ceiling_height: float | None = None
    """World z of the ceiling [m]; None if the log does not say."""

    @property
    def num_rows(self) -> int:
        """Number of rows T."""
        return self.time.size

    @property
    def num_rotors(self) -> int:
        """Number of rotors R."""
        rotors = self.rotor_speed if self.rotor_speed is not None else self.rotor_command
        assert rotors is not None
        return rotors.shape[1]


def load_flights(
    paths: Sequence[str | Path], robot: RobotCfg, *, mapping: LogMapping | None, bandwidth: float
) -> list[Flight]:
    """Return the flights of the files, with names that differ.

    Raises:
        DataError: If a file cannot be used, or is given twice.
    """
    seen: dict[Path, str] = {}
    flights: list[Flight] = []
    for path in paths:
        real = Path(path).resolve()
        if real in seen:
            raise DataError(f"{path}: is given twice (also as {seen[real]}); a flight is for training or for testing")
        seen[real] = str(path)
        flight = load_flight(path, robot, mapping=mapping, bandwidth=bandwidth)
        taken = {other.name for other in flights}
        name = flight.name if flight.name not in taken else f"{real.parent.name}/{flight.name}"
        flights.append(replace(flight, name=name))
    return flights


def load_flight(path: str | Path, robot: RobotCfg, *, mapping: LogMapping | None, bandwidth: float) -> Flight:
    """Return one flight: read, repeated values mended, made uniform, checked, rotor log aligned, missing states derived."""
    log = read_flight_log(path, mapping=mapping)
    check_quaternion_norm(log)
    log = uniform_log(mend_holds(log))
    notes = check_log(log, robot)
    return complete_flight(align_rotor_log(with_velocity(log), robot, bandwidth), notes)


def with_velocity(log: FlightLog) -> FlightLog:
    """Return the log with the velocity derived from the position if it has none of its own."""
    if log.lin_vel is not None or log.position is None:
        return log
    rate = rate_of(log)
    velocity = lowpass(log.position, rate, DERIVED_BAND * rate, derivative=True)
    return replace(log, lin_vel=velocity, notes=(*log.notes, "velocity derived from position"))


def align_rotor_log(log: FlightLog, robot: RobotCfg, bandwidth: float) -> FlightLog:
    """Return the log with rotor speeds on the clock of the accelerometer, where their thrust shows an offset.

    Without velocity, drag along z would look like an offset, so that the clock is believed.
    """
    if log.rotor_speed is None or log.specific_force is None or log.lin_vel is None:
        return log
    rows = vehicle_from_config(robot, num_envs=log.time.size, dtype=torch.float64)
    speed = torch.from_numpy(log.rotor_speed)
    force, _ = rotor_wrench(rows, evaluate_map(rows.thrust_map, speed), evaluate_map(rows.torque_map, speed))
    rate = rate_of(log)
    others = [Rotation.from_quat(log.attitude).apply(log.lin_vel, inverse=True)[:, 2:]]
    if log.ang_vel is not None:
        others.append(lowpass(log.ang_vel, rate, DERIVED_BAND * rate, derivative=True)[:, :2])
    thrust = (force[:, 2] / rows.mass).numpy()
    band = min(bandwidth, DERIVED_BAND * rate)
    known = np.concatenate(others, axis=1)
    return shift_rotor_log(log, rotor_log_lead(log.specific_force[:, 2], thrust, known, rate, band))


def complete_flight(log: FlightLog, notes: Sequence[str] = ()) -> Flight:
    """Return the flight with specific force and angular velocity derived where the log lacks them."""
    rate, said = rate_of(log), [*log.notes, *notes]
    band = DERIVED_BAND * rate
    specific_force, ang_vel = log.specific_force, log.ang_vel
    if log.lin_vel is None:
        said.append("neither velocity nor position: drag is predicted as if the vehicle stood still")
    elif specific_force is None:
        acceleration = lowpass(log.lin_vel, rate, band, derivative=True) + np.array([0.0, 0.0, STANDARD_GRAVITY])
        specific_force = Rotation.from_quat(log.attitude).apply(acceleration, inverse=True)
        said.append("specific force derived from velocity")
    if ang_vel is None:
        ang_vel = body_rate_of(log.attitude, rate, band)
        said.append("angular velocity derived from attitude; angular acceleration is not compared")
    if log.collective:
        said.append("one command for all rotors: angular acceleration is not compared")
    return Flight(
        name=log.name,
        path=log.path,
        rate=rate,
        time=log.time - log.time[0],
        position=log.position,
        attitude=log.attitude,
        lin_vel=log.lin_vel,
        ang_vel=ang_vel,
        attitude_integrated=log.attitude_integrated,
        gyro=log.ang_vel is not None and not log.collective,
        specific_force=specific_force,
        accelerometer=log.specific_force is not None,
        rotor_speed=log.rotor_speed,
        rotor_command=log.rotor_command,
        battery=log.battery,
        other_position=log.other_position,
        ground_height=log.ground_height,
        ceiling_height=log.ceiling_height,
        notes=tuple(said),
    )
