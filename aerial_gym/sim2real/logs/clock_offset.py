"""Correction of the rotor log's clock offset from the other sensors, or refusal of a larger delay. Letters: T rows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, rotor_wrench
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import LATE_S, FlightLog, sample_rate, take_rows
from aerial_gym.sim2real.logs.rotor_model import mean_time_constant
from aerial_gym.sim2real.logs.signals import DERIVED_BAND, apply_lag, interpolate_columns, lowpass, num_edge_rows

LARGEST_SHIFT_S = 0.05  # Largest clock offset of the rotor log that is searched [s]; measured_data.md 2: 0 to 0.03 s
SETTLED = 5.0  # Settling time of a lag in declared time constants

LEAST_SHIFT_GAIN = 0.3
"""Least relative reduction of the residual variance for an accepted offset. One row of a 100 Hz log or vertical drag
gives less; an offset of two rows gives half (measured on the IDSIA flights)."""

AGREEING = 4.0  # Offsets of several logs within this many standard deviations of their mean count as equal
CLEAR_ODDS = 20.0  # Least odds of a clock offset against delayed sensors if the flights disagree on the offset
PASSED = 0.85  # Noise bandwidth between both low-passes over the upper one: ``7/8 (pi/8) / sin(pi/8)``, less 0.05


@dataclass(frozen=True, kw_only=True)
class ClockOffset:
    """Lead of the rotor log over the other sensors."""

    rows: float = 0.0
    std: float = 0.0  # Standard deviation [rows]

    def is_likelier_than_sensor_delays(self, rate: float, odds: float = 1.0) -> bool:
        """Return whether the uniform clock offset is likelier, by ``odds``, than two normal sensor delays; ``rate`` in Hz."""
        spread = float(np.hypot(np.sqrt(2.0) * LATE_S, self.std / rate))
        of_sensors = np.exp(-0.5 * (self.rows / rate / spread) ** 2) / (np.sqrt(2.0 * np.pi) * spread)
        return bool(odds * of_sensors < 0.5 / LARGEST_SHIFT_S)


@dataclass(frozen=True, kw_only=True)
class OffsetCurve:
    """Residual of the accelerometer against the rotor log as a function of the clock offset."""

    rate: float  # Rows per second [Hz]
    left: Array
    """Unexplained share of the specific force along z at offsets -N..N [rows], (2 N + 1,); empty if too short."""

    samples: float  # Number of independent samples n

    @property
    def offset(self) -> ClockOffset:
        """Return the offset at the parabolic minimum S of ``left``, std ``sqrt(2 S / n S'')``; 0 if unclear."""
        if not self.left.size:
            return ClockOffset()
        most = self.left.size // 2
        best = int(np.argmin(self.left))
        # A minimum at the end of the range is rejected: another cause grows with the shift.
        if best in (0, 2 * most) or self.left[best] >= min((1.0 - LEAST_SHIFT_GAIN) * self.left[most], 0.5):
            return ClockOffset()
        before, least, after = self.left[best - 1 : best + 2]
        curvature = before - 2.0 * least + after
        least -= (before - after) ** 2 / (8.0 * curvature)
        return ClockOffset(
            rows=float(best - most + 0.5 * (before - after) / curvature),
            std=float(np.sqrt(2.0 * least / (self.samples * curvature))),
        )

    def is_zero_clearly_better(self, rows: float) -> bool:
        """Return whether zero offset fits clearly better than ``rows``."""
        if not self.left.size:
            return False
        most = self.left.size // 2
        moved = float(np.interp(rows, np.arange(-most, most + 1), self.left))
        return bool(self.left[most] < (1.0 - LEAST_SHIFT_GAIN) * moved)


def offset_curve(
    measured: Array, predicted: Array, disturbance: Array, rate: float, bandwidth: float, *,
    largest: float = LARGEST_SHIFT_S,
) -> OffsetCurve:  # fmt: skip
    """Return the residual curve of the accelerometer against the rotor log, for offsets up to ``largest`` [s].

    ``measured`` and ``predicted``: specific force along body z [m/s²], (T,), by accelerometer and rotor log.
    ``disturbance``: further regressors, (T, any). The pass band is ``bandwidth`` [Hz] and a twentieth of it; twice its
    width times the duration is the number of samples.
    """
    most = round(largest * rate)
    wave = np.column_stack((measured, predicted, disturbance))
    wave = lowpass(wave, rate, bandwidth) - lowpass(wave, rate, 0.05 * bandwidth)
    edge = num_edge_rows(rate, bandwidth) + most
    inner = slice(edge, -edge)
    target = wave[inner, 0]
    if target.size < 4 * edge or not np.any(target):
        return OffsetCurve(rate=rate, left=np.zeros(0), samples=0.0)
    left = np.empty(2 * most + 1)
    for place in range(left.size):
        causes = np.column_stack((np.roll(wave[:, 1], place - most)[inner], wave[inner, 2:]))
        gains = np.linalg.lstsq(causes, target, rcond=None)[0]
        left[place] = np.sum((target - causes @ gains) ** 2) / np.sum(target**2)
    return OffsetCurve(rate=rate, left=left, samples=2.0 * PASSED * bandwidth * target.size / rate)


def common_offsets(curves: Sequence[OffsetCurve], learning: int) -> list[ClockOffset]:
    """Return the clock offset of each log: a common one if the decisive logs agree, else each log's own.

    The first ``learning`` logs decide; others follow unless their data reject it. An offset that delayed sensors explain as
    well is 0. If the decisive logs disagree, the odds must exceed ``CLEAR_ODDS``: other vertical forces can imitate an
    offset.
    """
    told, agreed = _offsets_and_agreement_of_logs(curves, learning)
    odds = 1.0 if agreed else CLEAR_ODDS
    pairs = zip(told, curves, strict=True)
    return [one if one.is_likelier_than_sensor_delays(curve.rate, odds) else ClockOffset() for one, curve in pairs]


def _offsets_and_agreement_of_logs(curves: Sequence[OffsetCurve], learning: int) -> tuple[list[ClockOffset], bool]:
    """Return the offset of each log, and whether all decisive logs agree."""
    own = [one.offset for one in curves]
    told = list(zip(own, curves, strict=True))[:learning]
    known = [(offset.rows / one.rate, offset.std / one.rate) for offset, one in told if offset.std > 0.0]
    if not known:
        return own, True
    time, std = np.array(known).T
    mean, spread = float(np.sum(time / std**2) / np.sum(std**-2)), float(np.sum(std**-2) ** -0.5)
    if np.any(np.abs(time - mean) > AGREEING * std):
        return own, False
    same = [ClockOffset(rows=mean * one.rate, std=spread * one.rate) for one in curves]
    each = [
        offset
        if one.is_zero_clearly_better(moved.rows) or abs(offset.rows - moved.rows) > AGREEING * offset.std > 0.0
        else moved
        for offset, moved, one in zip(own, same, curves, strict=True)
    ]
    return each, all(offset is moved for offset, moved in zip(each[:learning], same, strict=False))


def commands_share_clock(logs: Sequence[FlightLog], offsets: Sequence[ClockOffset], time_constant: float) -> bool:
    """Return whether commands share the clock of the rotor speeds rather than that of the other sensors.

    On the right clock a first-order lag of 0.2 to 5 times ``time_constant`` [s] maps commands to speeds. The answer is
    common to all logs, as one log hardly separates a short offset from a lag.
    """
    pairs = zip(logs, offsets, strict=True)
    curve_values = [_lag_residuals_by_clock(log, offset, time_constant) for log, offset in pairs]
    told = [np.log(moved / stayed) for moved, stayed in filter(None, curve_values)]
    return not told or bool(np.mean(told) > np.log(1.0 - LEAST_SHIFT_GAIN))


def _lag_residuals_by_clock(log: FlightLog, offset: ClockOffset, time_constant: float) -> tuple[float, float] | None:
    """Return the least mean squared lag residuals with the commands on the other clock and on the rotor clock, or None."""
    speed, command = log.rotor_speed, log.rotor_command
    if round(offset.rows) == 0 or speed is None or command is None:
        return None
    whole = round(offset.rows)
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    edge = round(SETTLED * time_constant / step) + abs(whole)

    def least_residual_after_shift(shift: int) -> float:
        moved, curve_values = np.roll(command, shift, axis=0), []
        for constant in time_constant * np.geomspace(0.2, 5.0, 17):
            kept = np.exp(-step / constant)
            curve_values.append(np.mean((speed - apply_lag(moved, kept, speed[0]))[edge:-edge] ** 2))
        return float(min(curve_values))

    return least_residual_after_shift(-whole), least_residual_after_shift(0)


def shift_rotor_log(log: FlightLog, offset: ClockOffset, *, commands: bool = True) -> FlightLog:
    """Return the log with rotor speeds, and optionally commands, delayed by ``offset``, interpolated, without end rows."""
    if offset.rows == 0.0:
        return log
    rows, whole = np.arange(log.time.size, dtype=float), int(np.ceil(abs(offset.rows)))
    kept = slice(whole, None) if offset.rows > 0.0 else slice(0, -whole)
    moved: dict[str, Array] = {}
    for name in ("rotor_speed", "rotor_command")[: 1 + commands]:
        values = getattr(log, name)
        if values is not None:
            moved[name] = interpolate_columns(rows[kept] - offset.rows, rows, values)
    step = 1e3 * float(np.median(np.diff(log.time)))
    lead = {"lead_ms": offset.rows * step, "half_width_ms": 1.96 * offset.std * step, "with_commands": commands}
    note = Finding("rotor_log_moved", "", lead)
    return replace(take_rows(log, kept), **moved, notes=(*log.notes, note))


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


def with_rotors_on_sensor_clock(
    logs: Sequence[FlightLog], robot: RobotCfg, bandwidth: float, learning: int
) -> list[FlightLog]:
    """Return the logs with the rotor columns, delayed by their clock offset; the first ``learning`` decide."""
    offsets = rotor_clock_offsets(logs, robot, bandwidth, learning)
    together = commands_share_clock(logs[:learning], offsets[:learning], mean_time_constant(robot))
    return [shift_rotor_log(log, offset, commands=together) for log, offset in zip(logs, offsets, strict=True)]


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
