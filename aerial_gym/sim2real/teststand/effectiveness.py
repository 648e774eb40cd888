"""Effectiveness of rotors, and the curve and lag of their commands, by least squares over flights.

Effectiveness is the share of angular acceleration and specific force that a rotor gives per unit of its input: the squared
speed, or without measured speeds the command on the firmware's thrust curve. Both sides are smoothed to ``BAND_HZ``, above
which frame and sensors vibrate, less their mean over ``MEAN_S``, in which air flow moves the vehicle too. Rotors of one flight
move together. So the sign of each rotor is taken from all inputs at once, but the size about an axis from the sum of the inputs
with these signs. Letters: T rows, R rotors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter1d
from scipy.optimize import least_squares
from scipy.signal import lfilter

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.statistics import Estimate

BAND_HZ = 20.0  # Highest frequency of the regression
MEAN_S = 0.3  # Standard deviation of the Gaussian window whose mean is taken from each row [s]
EDGE_S = 1.0  # Rows this near to the start or end of a flight's powered part are left out: the reach of the window [s]
SLOWEST = 0.1  # A rotor below this share of the largest speed or command does not carry the vehicle
PARTS = 8  # Parts of the flights that are left out in turn for the intervals
CURVE_PARTS = 4  # The same for the command curve of a single flight
CURVE_HZ = 500.0  # Rate of the rows that show the command curve; rotors are slower than 10 ms
CLEAR = 2.0  # A sign is clear if the value is so many standard deviations from 0


@dataclass(frozen=True, kw_only=True)
class FlightRows:
    """Rows of one flight with all rotors turning, smoothed, less their moving mean."""

    inputs: Array  # Input of each rotor, (T, R)
    swings: Array  # Rate of change of the speeds [rad/s²], (T, R); 0 without measured speeds
    products: Array  # Products of body rates y z, z x, x y [rad²/s²], (T, 3)
    motion: Array  # Angular acceleration [rad/s²] and specific force along z [m/s²], (T, 4)
    lift: Array  # Unfiltered specific force along z [m/s²], and mean input of the rotors, (T, 2)
    force: float  # Mean norm of the specific force [m/s²]
    seconds: float  # Length of these rows [s]


@dataclass(frozen=True, kw_only=True)
class Effectiveness:
    """Motion per unit of input: roll, pitch and yaw acceleration, and specific force along z."""

    signs: Array  # Of each rotor about roll, pitch and yaw, 0 where not clear, (3, R)
    sizes: tuple[Estimate, ...]  # Size about each axis, and the specific force of one rotor


@dataclass(frozen=True, kw_only=True)
class CommandCurve:
    """Steady speed ``offset + gain (u / full)^power`` [rad/s] of a command u, and the lag [s] of the speed behind it."""

    offset: Estimate
    gain: Estimate
    power: Estimate
    lag: Estimate
    full: float = 1.0  # Full command; above 1 the largest one in the logs


def rows_of_flight(log: FlightLog, thrust_input: Callable[[FlightLog], Array]) -> FlightRows:
    """Return the filtered rows of a flight in which all rotors turn and the log has gyro and accelerometer."""
    if log.ang_vel is None or log.specific_force is None:
        raise DataError(
            f"{log.path}: needs a gyro, and an accelerometer or a velocity; log them, or map their columns (--mapping)"
        )
    rate, inputs = sample_rate(log), thrust_input(log)

    def in_band(values: Array) -> Array:
        smooth = gaussian_filter1d(values, rate * np.sqrt(np.log(2.0)) / (2.0 * np.pi * BAND_HZ), axis=0)
        return smooth - gaussian_filter1d(smooth, rate * MEAN_S, axis=0, truncate=3.0)

    rates = log.ang_vel
    products = np.stack([rates[:, j] * rates[:, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
    speeds = np.zeros_like(inputs) if log.rotor_speed is None else log.rotor_speed
    motion = np.concatenate((np.gradient(rates, axis=0) * rate, log.specific_force[:, 2:]), axis=1)
    rows = _rows_in_flight(inputs, rate)
    parts = (inputs, np.gradient(speeds, axis=0) * rate, products, motion)
    lift = np.stack((log.specific_force[rows, 2], inputs[rows].mean(axis=1)), axis=1)
    filtered = [in_band(part)[rows] for part in parts]
    force = float(np.linalg.norm(log.specific_force[rows], axis=1).mean()) if rows.any() else 0.0
    return FlightRows(
        inputs=filtered[0], swings=filtered[1], products=filtered[2], motion=filtered[3], lift=lift, force=force,
        seconds=float(rows.sum() / rate),
    )  # fmt: skip


def _rows_in_flight(inputs: Array, rate: float) -> Flags:
    """Return the rows in which all rotors turn, without the edges of such spans, (T,)."""
    turning = (inputs > SLOWEST**2 * np.quantile(inputs, 0.99)).all(axis=1)
    return np.asarray(binary_erosion(turning, np.ones(2 * round(EDGE_S * rate) + 1)), dtype=np.bool_)


def fit_effectiveness(flights: Sequence[FlightRows], logged_signs: Array | None) -> Effectiveness:
    """Return signs and sizes of the effectiveness, with intervals by leaving out parts of the flights."""
    inputs, swings, products, motion = (
        np.concatenate([getattr(flight, name) for flight in flights])
        for name in ("inputs", "swings", "products", "motion")
    )
    part = np.arange(len(inputs)) * PARTS // len(inputs)
    kept = [part != k for k in range(PARTS)]

    def single_rotors(rows: Flags) -> Array:
        columns = np.concatenate((inputs, swings, products), axis=1)[rows]
        return _least_squares(columns, motion[rows, :3])[: inputs.shape[1]].T

    whole, deviation = _jackknife(single_rotors, kept)
    clear = (np.abs(whole) > CLEAR * deviation).all(axis=1, keepdims=True)
    patterns = np.where(clear | (logged_signs is None), np.sign(whole), 0.0 if logged_signs is None else logged_signs)

    def sizes(rows: Flags) -> Array:
        sums = inputs[rows] @ np.concatenate((patterns, np.ones((1, inputs.shape[1])))).T
        spin_up = (swings[rows] @ patterns[2])[:, None]
        fit = _least_squares(np.concatenate((sums, spin_up, products[rows]), axis=1), motion[rows])
        return np.diag(fit[:4])

    value, spread = _jackknife(sizes, kept)
    turned = np.append(np.sign(value[:3]), 1.0)  # logged signs that the flight contradicts
    known = np.abs(value[:3]) > CLEAR * spread[:3] if logged_signs is not None else clear[:, 0]
    signs = patterns * (turned[:3] * known)[:, None]
    return Effectiveness(
        signs=np.asarray(signs, dtype=np.float64),
        sizes=tuple(map(Estimate.from_half_width, turned * value, CLEAR * spread)),
    )


def mean_lift(flights: Sequence[FlightRows]) -> Estimate:
    """Return the specific force along z over the sum of the rotors' inputs in the mean of the flights."""
    lift = np.concatenate([flight.lift for flight in flights])
    count = flights[0].inputs.shape[1]
    part = np.arange(len(lift)) * PARTS // len(lift)

    def ratio(rows: Flags) -> Array:
        force, total = lift[rows].mean(axis=0)
        return np.atleast_1d(force / max(count * total, 1e-300))

    value, deviation = _jackknife(ratio, [part != k for k in range(PARTS)])
    return Estimate.from_half_width(float(value[0]), float(CLEAR * deviation[0]))


def _least_squares(columns: Array, targets: Array) -> Array:
    scale = np.maximum(np.sqrt((columns * columns).mean(axis=0)), 1e-300)
    return np.linalg.lstsq(columns / scale, targets, rcond=None)[0] / scale[:, None]


def _jackknife(fit: Callable[[Flags], Array], kept: Sequence[Flags]) -> tuple[Array, Array]:
    """Return the fit to all rows, and its standard deviation from fits that leave out one part each."""
    whole = fit(np.ones(kept[0].size, dtype=bool))
    parts = np.stack([fit(rows) for rows in kept])
    count = len(kept)
    return whole, np.sqrt((count - 1) / count * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))


def fit_command_curve(logs: Sequence[FlightLog]) -> CommandCurve | None:
    """Return the steady speed of a command and the lag behind it; None without measured speeds and fast commands."""
    if any(log.rotor_command is None or log.rotor_speed is None for log in logs):
        return None
    parts = [part for log in logs for part in _curve_parts(log, CURVE_PARTS if len(logs) == 1 else 1)]
    full = max(1.0, max(float(part.command.max()) for part in parts))
    largest = max(float(part.speed.max()) for part in parts)

    def residual(params: Array, chosen: Sequence[int]) -> Array:
        offset, gain, power, lag = params * (largest, largest, 1.0, 0.02)
        errors = []
        for part in (parts[k] for k in chosen):
            share = np.exp(-1.0 / (part.rate * max(lag, 1e-4)))
            steady = offset + gain * (np.clip(part.command, 0.0, None) / full) ** power
            state = lfilter([0.0, 1.0 - share], [1.0, -share], steady - steady[:1], axis=0) + steady[:1]
            errors.append(((state - part.speed) / largest)[part.rows].reshape(-1))
        return np.concatenate(errors)

    def fit(chosen: Sequence[int], start: Array) -> Array:
        low, high = (0.0, 0.1, 0.3, 0.05), (0.6, 2.0, 1.5, 10.0)
        return np.asarray(least_squares(residual, start, bounds=(low, high), args=(chosen,)).x, dtype=np.float64)

    count = range(len(parts))
    whole = fit(list(count), np.array((0.1, 0.9, 0.7, 1.0)))
    scale = np.array((largest, largest, 1.0, 0.02))
    leave_one_out = np.array([fit([k for k in count if k != left], whole) for left in count])
    variance = (len(parts) - 1) / len(parts) * ((leave_one_out - leave_one_out.mean(axis=0)) ** 2).sum(axis=0)
    offset, gain, power, lag = map(Estimate.from_half_width, whole * scale, CLEAR * np.sqrt(variance) * scale)
    return CommandCurve(offset=offset, gain=gain, power=power, lag=lag, full=full)


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
    turning = _rows_in_flight(speed**2, rate)
    groups = np.array_split(np.flatnonzero(turning), count)
    rows = [np.isin(np.arange(len(speed)), group) for group in groups if group.size]
    return [CurvePart(command=command, speed=speed, rate=rate, rows=flags) for flags in rows]
