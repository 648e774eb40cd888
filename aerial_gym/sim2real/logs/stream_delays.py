"""Delays of the streams behind the inertial sensors, without a model of the vehicle.

The gyro gives the clock of a flight. Attitude and rotors are compared with it, velocity with the accelerometer, position with
velocity. A late attitude turns gravity late, and so looks like an early horizontal velocity. A late accelerometer reads thrust
late, and so looks like an early vertical velocity; its lag behind the attitude is fitted beside the delay of the velocity.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation, Slerp

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.kinematics import (
    ALL_MOTION,
    CHECK_BANDWIDTH_HZ,
    MATERIAL,
    edge_of_band,
    fit_sensor_errors,
    in_band,
    rate_by_differences,
)
from aerial_gym.sim2real.logs.recording import AT_REST, LATE_S, FlightLog, StreamTiming, sample_rate, take_rows
from aerial_gym.sim2real.logs.rotor_delays import rotor_delay
from aerial_gym.sim2real.logs.row_grid import SLOWEST_COMMANDS_HZ
from aerial_gym.sim2real.logs.signals import interpolate_columns, log_at_equal_steps, lowpass

DELAY_ROWS_HZ = 125.0  # Enough rows for the comparison, 30 a period at its largest frequency
DELAY_SPAN_S = 600.0  # Longest part of a flight, about its middle, in which delays are searched [s]
LARGEST_S = 0.5  # Largest delay that is searched [s]
WITHIN_TOLERANCE_S = 3.0 * LATE_S  # Delay of rows [s] that the tolerance of a sensor's delay covers: three std
CORRECTED_S = 0.25  # Largest delay that is corrected [s]; a stream with a larger one is left out
TRIALS = 41  # Delays of the coarse search; their distance is a tenth of a period of the comparison
REFINEMENTS = 3  # Linear fits about the best delay; each one reduces the error by its square


@dataclass(frozen=True, kw_only=True)
class StreamDelay:
    """Measured delay of a stream behind the inertial sensors."""

    quantity: str
    delay: float  # [s], positive: the stream is late
    half_width: float  # Half width of its 95 % interval [s]
    with_lag: bool = False  # Whether it is that of commands, less the rotor lag

    @property
    def is_material(self) -> bool:
        """Return whether the delay is significant and large enough to matter.

        Torques of other causes bias that of the rotors by some 10 ms, so that it is stated only, up to ``CORRECTED_S``. With a
        robot file, ``rotor_clock_offsets`` of all flights together corrects it.
        """
        if self.quantity.startswith("rotor"):
            return abs(self.delay) - self.half_width > CORRECTED_S
        return abs(self.delay) > max(self.half_width, MATERIAL["clock"])


def correct_row_delays(log: FlightLog) -> FlightLog:
    """Return rows of a text log without delays of attitude, velocity and position beyond their tolerance.

    Smaller delays are nuisance parameters of every prediction. A stream later than ``CORRECTED_S`` is left out, except the
    attitude, which the checks of the log judge.
    """
    corrected = any(name != one.source for name, one in log.streams.items())  # by a reader of binary logs
    delays = {} if corrected else stream_delays(log)
    delays = {
        name: one for name, one in delays.items() if not name.startswith("rotor")
    }  # the robot's rotors give theirs
    late = {n: one for n, one in delays.items() if abs(one.delay) - one.half_width > WITHIN_TOLERANCE_S}
    changes: dict[str, Array | None] = {}
    notes, timings, first, last = list(log.notes), dict(log.streams), log.time[0], log.time[-1]
    for name, one in late.items():
        values = {"topic": name, "late_ms": 1e3 * one.delay, "half_width_ms": 1e3 * one.half_width}
        far = abs(one.delay) > CORRECTED_S
        if far and name == "attitude":
            continue
        notes.append(Finding("stream_too_late" if far else "stream_moved", "", values))
        changes[name] = None if far else stream_later(log, name, one.delay)
        if not far:
            first, last = max(first, log.time[0] - one.delay), min(last, log.time[-1] - one.delay)
            known = timings.get(name, StreamTiming(source=name, rate=sample_rate(log)))
            timings[name] = replace(known, delay=one.delay, half_width=one.half_width)
    times = {
        n: t - late[n].delay if n in late else t for n, t in log.sample_times.items() if changes.get(n, t) is not None
    }
    moved = replace(log, **changes, streams=timings, sample_times=times, notes=tuple(notes))
    return take_rows(with_motion_between_samples(moved), (log.time >= first) & (log.time <= last))


def with_motion_between_samples(log: FlightLog) -> FlightLog:
    """Return the log with slow velocities and positions that follow the measured acceleration between their samples.

    A straight line over a step h is wrong by ``h² / 12`` of the second derivative, on average. For a velocity this is the
    jerk, which follows the angular velocity: it would look like a displaced sensor.
    """
    if log.specific_force is None or log.attitude_integrated:
        return log
    acceleration = Rotation.from_quat(log.attitude).apply(log.specific_force) - AT_REST
    for name, rate in (("lin_vel", acceleration), ("position", None)):
        at, values = log.sample_times.get(name), getattr(log, name)
        rate = log.lin_vel if rate is None else rate
        if at is not None and values is not None and rate is not None:
            motion = cumulative_trapezoid(rate, log.time, axis=0, initial=0.0)
            error = interpolate_columns(at, log.time, values - motion)
            log = replace(log, **{name: motion + interpolate_columns(log.time, at, error)})
    return log


def stream_later(log: FlightLog, name: str, seconds: float) -> Array:
    """Return the values of a stream that the log shows ``seconds`` later, (T, any)."""
    if name == "attitude":
        return _attitude_later(log, seconds)
    return interpolate_columns(log.time + seconds, log.time, getattr(log, name))


def stream_delays(log: FlightLog, band: tuple[float, float] = ALL_MOTION) -> dict[str, StreamDelay]:
    """Return the delays that the motion of a flight shows in a band [Hz], by quantity; those of rotors have their own band."""
    if np.ptp(log.time) < 4.0 * LARGEST_S:
        return {}
    even, results = log_at_equal_steps(log), dict[str, StreamDelay]()
    turning = _rotation_pair(even)
    attitude = None if turning is None else _fit_delay("attitude", "gyro", *turning, sample_rate(even), band)
    if attitude is not None:
        results["attitude"] = attitude
        even = replace(even, attitude=_attitude_later(even, attitude.delay if attitude.is_material else 0.0))
    for name, sensor, measured, motion, change in _velocity_pairs(even, vertical=attitude is None):
        if (one := _fit_delay(name, sensor, measured, motion, sample_rate(even), band, change)) is not None:
            results[name] = one
    if attitude is not None and (velocity := results.get("lin_vel")) is not None:
        half_width = float(np.hypot(velocity.half_width, attitude.half_width))
        results["lin_vel"] = replace(velocity, half_width=half_width)
    return _delays_behind_sensors(log, results) | _rotor_delays(even, log.streams)


def _rotor_delays(log: FlightLog, streams: Mapping[str, StreamTiming]) -> dict[str, StreamDelay]:
    """Return the delays of rotor speeds and commands that are fast enough to show them."""
    results = dict[str, StreamDelay]()
    for name in ("rotor_speed", "rotor_command"):
        rotors, timing = getattr(log, name), streams.get(name)
        if rotors is None or timing is None or timing.rate < SLOWEST_COMMANDS_HZ:
            continue
        if (fit := rotor_delay(log, rotors, LARGEST_S)) is not None:
            with_lag = name == "rotor_command"
            results[name] = StreamDelay(quantity=name, delay=fit[0], half_width=fit[1], with_lag=with_lag)
    return results


def _attitude_later(log: FlightLog, seconds: float) -> Array:
    """Return the attitude (T, 4) that the log shows ``seconds`` later."""
    at = np.clip(log.time + seconds, log.time[0], log.time[-1])
    return Slerp(log.time, Rotation.from_quat(log.attitude))(at).as_quat()


def _delays_behind_sensors(log: FlightLog, delays: dict[str, StreamDelay]) -> dict[str, StreamDelay]:
    """Return the delays with that of the position, measured against the velocity, behind the inertial sensors as well.

    Position and velocity of one topic have the same stamps, and so the same delay.
    """
    velocity, position = delays.get("lin_vel"), delays.pop("position", None)
    if velocity is None or log.position is None:
        return delays
    same = {name: log.streams[name].source for name in ("position", "lin_vel") if name in log.streams}
    if len(set(same.values())) == 1 < len(same):
        return delays | {"position": replace(velocity, quantity="position")}
    if position is None:
        return delays
    half_width = float(np.hypot(position.half_width, velocity.half_width))
    return delays | {"position": replace(position, delay=position.delay + velocity.delay, half_width=half_width)}


def _rotation_pair(log: FlightLog) -> tuple[Array, Array] | None:
    """Return the gyro and the angular velocity by the attitude, (T, 3) each; None without both."""
    if log.ang_vel is None or log.attitude_integrated:
        return None
    return log.ang_vel, rate_by_differences(log.attitude, sample_rate(log))


def _velocity_pairs(log: FlightLog, *, vertical: bool) -> Iterator[tuple[str, str, Array, Array, Array | None]]:
    """Yield stream, sensor of its comparison, the sensor's values and the stream's motion, in world axes, (T, 3) each.

    Last is the derivative of the accelerometer's reading in body axes, turned to world axes; None if it shows no other delay.
    ``vertical``: whether only vertical accelerations count, for an attitude of unknown delay.
    """
    axes = (0.0, 0.0, 1.0) if vertical else (1.0, 1.0, 1.0)
    rate, attitude = sample_rate(log), Rotation.from_quat(log.attitude)
    band = min(2.0 * CHECK_BANDWIDTH_HZ, 0.2 * rate)
    if log.lin_vel is not None and log.specific_force is not None:
        motion = (lowpass(log.lin_vel, rate, band, derivative=True) + AT_REST) * axes
        change = attitude.apply(lowpass(log.specific_force, rate, band, derivative=True))
        measured = attitude.apply(log.specific_force) * axes
        yield "lin_vel", "accelerometer", measured, motion, None if vertical else change
    if log.position is not None and log.lin_vel is not None:
        yield "position", "velocity", log.lin_vel, lowpass(log.position, rate, band, derivative=True), None


def _fit_delay(
    name: str, sensor: str, measured: Array, motion: Array, rate: float, band: tuple[float, float],
    change: Array | None = None,
) -> StreamDelay | None:  # fmt: skip
    """Return the delay of ``motion`` behind ``measured``, (T, 3) each; None if the motion does not show it.

    ``change``: derivative of ``measured`` in axes whose clock it may lag, (T, 3).
    """
    level = AT_REST if sensor == "accelerometer" else np.zeros(3)
    delay = _best_trial(measured - level, motion - level, rate, band)
    time = np.arange(len(motion)) / rate
    for _ in range(REFINEMENTS):
        moved = interpolate_columns(time + delay, time, motion)
        errors = fit_sensor_errors(sensor, measured, moved, level, rate, own_change=change, band=band)
        if errors is None or not np.isfinite(errors.half_width[6]):
            return None
        delay -= errors.delay
    return StreamDelay(quantity=name, delay=float(delay), half_width=float(errors.half_width[6]))


def _best_trial(measured: Array, motion: Array, rate: float, band: tuple[float, float]) -> float:
    """Return the delay of the coarse search with the least squared difference [s]."""
    slow, other = in_band(measured, rate, band), in_band(motion, rate, band)
    edge = edge_of_band(rate, band) + round(LARGEST_S * rate)
    if len(slow) <= 2 * edge:
        return 0.0
    shifts = np.unique(np.rint(np.linspace(-LARGEST_S, LARGEST_S, TRIALS) * rate).astype(int))
    errors = [np.sum((slow[edge:-edge] - other[edge + n : len(other) - edge + n]) ** 2) for n in shifts]
    return float(shifts[int(np.argmin(errors))]) / rate
