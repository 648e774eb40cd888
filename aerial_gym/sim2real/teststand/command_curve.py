"""Exponent of the thrust of commands, and steady speed and lag of the speed behind the command, by least squares over flights.

Letters: T rows, R rotors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand.effectiveness import (
    BAND_STD_S,
    fit_with_jackknife_interval,
    jackknife_half_width,
    rows_under_power,
    rows_without_each_part,
    without_edges,
)

THRUST_MEAN_S = 0.3  # The same for the thrust of commands [s]; inflow by a climb is slower
CURVE_PARTS = 4  # The same for the command curve of a single flight
CURVE_HZ = 500.0  # Rate of the rows that show the command curve; rotors are slower than 10 ms


@dataclass(frozen=True, kw_only=True)
class CommandCurve:
    """Steady speed ``offset + gain (u / full)^power`` [rad/s] of a command u, and the lag [s] of the speed behind it."""

    offset: Estimate
    gain: Estimate
    power: Estimate
    lag: Estimate
    full: float = 1.0  # Full command; above 1 the largest one in the logs
    reached: float  # Largest speed of the fit, 99.9th percentile [rad/s]

    @property
    def full_speed(self) -> float:
        """Steady speed of a full command [rad/s]."""
        return self.offset.value + self.gain.value


def fit_thrust_power(logs: Sequence[FlightLog]) -> tuple[Estimate, Estimate] | None:
    """Return exponent p and lag [s] of a specific force ``c sum u^p`` of commands u; None if these are too slow.

    Both sides are smoothed to ``BAND_HZ``, less their mean over ``THRUST_MEAN_S``. The mean force fixes c. A force by the
    velocity along z, of drag and inflow, is fitted too. The interval of p has the results with half and with twice that time.
    """
    flights = []
    for log in logs:
        if log.rotor_command is None or log.specific_force is None or not log.torques:
            return None
        rate, command = sample_rate(log), np.clip(log.rotor_command, 1e-6, None)
        rows = without_edges(rows_under_power(command**2), rate)
        climb = np.zeros_like(log.time)
        if log.lin_vel is not None:
            climb = Rotation.from_quat(log.attitude).apply(log.lin_vel, inverse=True)[:, 2]
        force, climb = (gaussian_filter1d(one, rate * BAND_STD_S) for one in (log.specific_force[:, 2], climb))
        if rows.any():
            flights.append((rate, command, force, climb, rows))
    if not flights:
        return None
    kept = rows_without_each_part([int(rows.sum()) for *_, rows in flights])

    def residual(params: Array, chosen: Flags, window: float) -> Array:
        parts = []
        for rate, command, force, climb, rows in flights:
            thrust = _values_with_lag((command ** params[0]).sum(axis=1), 0.02 * params[1], rate)
            thrust = gaussian_filter1d(thrust, rate * BAND_STD_S)
            both = np.stack((force, climb))  # less the thrusts with the same means
            both = both - both[:, rows].mean(axis=1, keepdims=True) / thrust[rows].mean() * thrust
            parts.append((both - gaussian_filter1d(both, rate * window, axis=1, truncate=3.0))[:, rows])
        error, climb = np.concatenate(parts, axis=1)[:, chosen]
        return error - climb * (climb @ error) / max(climb @ climb, 1e-300)

    whole, start = np.ones(kept[0].size, dtype=bool), np.array((1.5, 1.5))

    def fit(chosen: Flags, window: float = THRUST_MEAN_S) -> Array:
        args, bounds = (chosen, window), ((0.2, 0.05), (4.0, 15.0))
        return np.asarray(least_squares(residual, start, bounds=bounds, args=args, xtol=1e-5).x)

    start = np.clip(fit(whole), (0.21, 0.051), (3.99, 14.9))  # within the bounds, for the fits to parts
    value, half = fit_with_jackknife_interval(fit, kept)
    power, lag = map(Estimate.from_half_width, value * (1.0, 0.02), half * (1.0, 0.02))
    ends = [float(fit(whole, factor * THRUST_MEAN_S)[0]) for factor in (0.5, 2.0)]
    return replace(power, low=min(power.low, *ends), high=max(power.high, *ends)), lag


def _values_with_lag(values: Array, lag: float, rate: float) -> Array:
    """Return values (T, ...) behind a first-order lag [s], from rest at the first one."""
    share = np.exp(-1.0 / (rate * max(lag, 1e-4)))
    return lfilter([0.0, 1.0 - share], [1.0, -share], values - values[:1], axis=0) + values[:1]


def _values_later(values: Array, rows: float) -> Array:
    """Return values (T, R) later by a number of rows, with straight lines between rows."""
    at = np.clip(np.arange(len(values)) - rows, 0.0, None)
    before = at.astype(int)
    share, after = (at - before)[:, None], np.minimum(before + 1, len(values) - 1)
    return (1.0 - share) * values[before] + share * values[after]


def fit_command_curve(logs: Sequence[FlightLog]) -> CommandCurve | None:
    """Return the steady speed of a command and the lag behind it; None without measured speeds and fast commands.

    The interval of the lag includes the shorter lag beside a dead time, which the flight fits as well.
    """
    if any(log.rotor_command is None or log.rotor_speed is None for log in logs):
        return None
    parts = [part for log in logs for part in _curve_parts(log, CURVE_PARTS if len(logs) == 1 else 1)]
    full = max(1.0, max(float(part.command.max()) for part in parts))
    largest = max(float(part.speed.max()) for part in parts)

    def residual(params: Array, chosen: Sequence[int]) -> Array:
        offset, gain, power, lag, dead = np.append(params, 0.0)[:5] * (largest, largest, 1.0, 0.02, 0.02)
        errors = []
        for part in (parts[k] for k in chosen):
            command = np.clip(_values_later(part.command, dead * part.rate), 0.0, None)
            state = _values_with_lag(offset + gain * (command / full) ** power, lag, part.rate)
            errors.append(((state - part.speed) / largest)[part.rows].reshape(-1))
        return np.concatenate(errors)

    def fit(chosen: Sequence[int], start: Array) -> Array:
        low, high = (np.array(ends)[: start.size] for ends in ((0.0, 0.1, 0.3, 0.05, 0.0), (0.6, 2.0, 1.5, 10.0, 2.5)))
        return np.asarray(least_squares(residual, start, bounds=(low, high), args=(chosen,)).x, dtype=np.float64)

    count = range(len(parts))
    whole = fit(list(count), np.array((0.1, 0.9, 0.7, 1.0)))
    scale = np.array((largest, largest, 1.0, 0.02))
    half = jackknife_half_width([fit([k for k in count if k != left], whole) for left in count])
    offset, gain, power, lag = map(Estimate.from_half_width, whole * scale, half * scale)
    beside = float(fit(list(count), np.append(whole, 0.05))[3] * scale[3])
    lag = Estimate(value=lag.value, low=min(lag.low, beside - half[3] * scale[3]), high=lag.high)
    reached = float(np.quantile(np.concatenate([part.speed[part.rows].ravel() for part in parts]), 0.999))
    return CommandCurve(offset=offset, gain=gain, power=power, lag=lag, full=full, reached=reached)


@dataclass(frozen=True, kw_only=True)
class CurvePart:
    """Commands and speeds of one flight, with the rows of one part of it."""

    command: Array  # (T, R)
    speed: Array  # [rad/s], (T, R)
    rate: float  # [Hz]
    rows: Flags  # (T,)


def _curve_parts(log: FlightLog, count: int) -> list[CurvePart]:
    """Return equal parts of the rows with all rotors turning, thinned to ``CURVE_HZ``."""
    assert log.rotor_command is not None
    assert log.rotor_speed is not None
    step = max(1, int(sample_rate(log) / CURVE_HZ))
    command, speed, rate = log.rotor_command[::step], log.rotor_speed[::step], sample_rate(log) / step
    turning = without_edges(rows_under_power(speed**2), rate)
    groups = np.array_split(np.flatnonzero(turning), count)
    rows = [np.isin(np.arange(len(speed)), group) for group in groups if group.size]
    return [CurvePart(command=command, speed=speed, rate=rate, rows=flags) for flags in rows]
