"""Correction of the rotor log's clock, or refusal of a delay beyond all clock offsets. Letters: T rows."""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, rotor_wrench
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.clock_offset import (
    LARGEST_SHIFT_S,
    ClockOffset,
    OffsetCurve,
    common_offsets,
    offset_curve,
)
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import DERIVED_BAND, lowpass

FAR_S = 0.25  # Largest delay of the rotor log that is searched [s]
FAR_GAIN = 0.5  # Largest residual of an accepted delay, relative to that of the best clock offset
ROWS_PER_BAND = 10.0  # Sample rate of the delay search in units of the bandwidth


def rotor_clock_offsets(
    logs: Sequence[FlightLog], robot: RobotCfg, bandwidth: float, learning: int
) -> list[ClockOffset]:
    """Return the clock offset of each rotor log, 0 without velocity, whose drag imitates one; the first ``learning`` decide."""
    able = [log.rotor_speed is not None and log.specific_force is not None and log.lin_vel is not None for log in logs]
    curves = [force_offset_curve(log, robot, bandwidth) for log, one in zip(logs, able, strict=True) if one]
    offsets = iter(common_offsets(curves, sum(able[:learning])))
    return [next(offsets) if one else ClockOffset() for one in able]


def force_offset_curve(
    log: FlightLog, robot: RobotCfg, bandwidth: float, *, largest: float = LARGEST_SHIFT_S, stride: int = 1
) -> OffsetCurve:
    """Return the residual curve of vertical force against rotor speeds up to ``largest`` [s], of every ``stride`` rows."""
    assert log.specific_force is not None
    assert log.lin_vel is not None
    thrust, _ = _rotor_wrench(log, robot)
    body_velocity = [Rotation.from_quat(log.attitude).apply(log.lin_vel, inverse=True)[:, 2:]]
    if log.ang_vel is not None:
        body_velocity.append(_angular_acceleration(log)[:, :2])
    waves = np.column_stack((log.specific_force[:, 2], thrust, *body_velocity))
    return _offset_curve_of_waves(waves, sample_rate(log), bandwidth, largest, stride)


def rotation_offset_curves(
    log: FlightLog, robot: RobotCfg, bandwidth: float, *, largest: float, stride: int
) -> list[OffsetCurve]:
    """Return the residual curves of roll and pitch acceleration, free of other vertical forces; empty without a gyro."""
    if log.ang_vel is None:
        return []
    _, torque = _rotor_wrench(log, robot)
    turning, rate = _angular_acceleration(log), sample_rate(log)
    pairs = (np.column_stack((turning[:, axis], torque[:, axis])) for axis in (0, 1))
    return [_offset_curve_of_waves(waves, rate, bandwidth, largest, stride) for waves in pairs]


def _rotor_wrench(log: FlightLog, robot: RobotCfg) -> tuple[Array, Array]:
    """Return the rotors' specific force along z [m/s²], (T,), and torque [N m], (T, 3), at the logged speeds."""
    assert log.rotor_speed is not None
    rows = vehicle_from_config(robot, num_envs=log.time.size, dtype=torch.float64)
    speed = torch.from_numpy(log.rotor_speed)
    force, torque = rotor_wrench(rows, rotor_thrust(rows, speed), rotor_torque(rows, speed))
    return (force[:, 2] / rows.mass).numpy(), torque.numpy()


def _angular_acceleration(log: FlightLog) -> Array:
    """Return the angular acceleration [rad/s²], body, (T, 3)."""
    assert log.ang_vel is not None
    rate = sample_rate(log)
    return lowpass(log.ang_vel, rate, DERIVED_BAND * rate, derivative=True)


def _offset_curve_of_waves(waves: Array, rate: float, bandwidth: float, largest: float, stride: int) -> OffsetCurve:
    """Return the residual curve of columns (T, any): measurement, rotor prediction, other regressors; thinned by ``stride``."""
    band = min(bandwidth, DERIVED_BAND * rate)
    if stride > 1:
        waves, rate = lowpass(waves, rate, 2.0 * band)[::stride], rate / stride
    return offset_curve(waves[:, 0], waves[:, 1], waves[:, 2:], rate, band, largest=largest)


def check_rotor_clock(log: FlightLog, robot: RobotCfg, bandwidth: float) -> None:
    """Raise ``DataError`` if rotor speeds lead or lag beyond any clock offset, unless roll and pitch contradict this."""
    if log.rotor_speed is None or log.specific_force is None or log.lin_vel is None:
        return
    stride = max(1, int(sample_rate(log) / (ROWS_PER_BAND * bandwidth)))
    curve = force_offset_curve(log, robot, bandwidth, largest=FAR_S, stride=stride)
    if not curve.left.size:
        return
    rows = np.arange(curve.left.size) - curve.left.size // 2
    near = np.abs(rows) <= LARGEST_SHIFT_S * curve.rate
    best = int(np.argmin(curve.left))
    if near[best] or best in (0, rows.size - 1) or curve.left[best] > FAR_GAIN * min(curve.left[near].min(), 1.0):
        return
    for turning in rotation_offset_curves(log, robot, bandwidth, largest=FAR_S, stride=stride):
        if turning.left.size and turning.left[near].min() < FAR_GAIN * turning.left[best]:
            return
    time, most = 1e3 * float(rows[best]) / curve.rate, 1e3 * LARGEST_SHIFT_S
    way = f"{'lead' if time > 0.0 else 'lag'} the accelerometer by {abs(time):.0f} ms"
    raise DataError(
        f"{log.path}: rotor_1..{log.num_rotors} {way}, more than any clock offset ({most:.0f} ms); correct the time of "
        "these columns, or name them cmd_* if they are commands and not measurements"
    )
