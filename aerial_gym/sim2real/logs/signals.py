"""Zero-phase low-pass, derivatives, spectra and uniform time steps.

All filters use future samples: they are for logs, not for flight. Letters: T rows, K columns.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.math.decay import sum_with_decay
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.stamps import MOST_BAD, SHOWN
from aerial_gym.sim2real.logs.recording import (
    GAP_STEPS,
    NORM_OFF,
    FlightLog,
    longest_bridgeable_gap,
    row_arrays,
    take_rows,
)

FILTER_ORDER = 4  # Order of the Butterworth low-pass, which runs forwards and backwards
IN_BAND = ("ang_vel", "specific_force", "rotor_speed", "rotor_command")  # Quantities whose spectra are compared
DERIVED_BAND = 0.2  # Bandwidth of derivatives that replace a sensor, as a share of the rate


def lowpass_gain(frequency: Array, bandwidth: float) -> Array:
    """Return the gain ``1 / (1 + (f / b)^8)`` of a Butterworth low-pass of order 4 run forwards and backwards.

    Source: Oppenheim, Schafer (2010), Discrete-Time Signal Processing, B.1: the squared magnitude of a Butterworth filter.
    """
    return 1.0 / (1.0 + (frequency / bandwidth) ** (2 * FILTER_ORDER))


def lowpass(values: Array, rate: float, bandwidth: float, *, derivative: bool = False, late: float = 0.0) -> Array:
    """Return ``values`` (T, ...) after a zero-phase low-pass, or their time derivative in the same band.

    Both ends continue by point reflection about a line fitted to the last half period, against ringing; rows within
    ``num_edge_rows`` should still be excluded. Columns are independent, bit for bit. ``bandwidth``: frequency of half gain
    [Hz]. ``late``: delay of the result [s], at most ``num_edge_rows``, exact in the band.
    """
    columns = np.ascontiguousarray(values.reshape(values.shape[0], -1).T)
    slow = lowpass_columns(columns, rate, bandwidth, derivative=derivative, late=late)
    return np.ascontiguousarray(slow.T).reshape(values.shape)


def lowpass_columns(
    columns: Array, rate: float, bandwidth: float, *, derivative: bool = False, late: float = 0.0
) -> Array:
    """Return ``lowpass`` for columns (K, T), in the same layout."""
    rows = columns.shape[1]
    pad = min(rows - 1, 3 * num_edge_rows(rate, bandwidth))
    end = _weights_of_line_start(min(rows, max(2, round(0.5 * rate / bandwidth))))
    size = int(fft.next_fast_len(rows + 3 * pad, real=True) or 0)
    circle, whole = np.empty((len(columns), size)), 2 * pad + rows
    inner = circle[:, pad : pad + rows]
    inner[:] = columns
    first = 2.0 * (inner[:, : end.size] * end).sum(axis=1, keepdims=True)
    last = 2.0 * (inner[:, : -end.size - 1 : -1] * end).sum(axis=1, keepdims=True)
    np.subtract(first, inner[:, pad:0:-1], out=circle[:, :pad])
    np.subtract(last, inner[:, -2 : -pad - 2 : -1], out=circle[:, pad + rows : whole])
    # A straight line closes the circle without a jump.
    blend = _inner_points_of_ramp(size - whole)
    circle[:, whole:] = circle[:, whole - 1 : whole] * (1.0 - blend) + circle[:, :1] * blend
    lines = np.asarray(fft.rfft(circle, axis=1, overwrite_x=True))
    factors = _lowpass_line_factors(size, rate, bandwidth, derivative)
    lines.view(factors.dtype)[...] *= factors
    if late:
        lines *= _delay_line_factors(size, rate, late)
    return np.asarray(fft.irfft(lines, n=size, axis=1, overwrite_x=True))[:, pad : pad + rows]


@lru_cache(maxsize=32)
def _lowpass_line_factors(size: int, rate: float, bandwidth: float, derivative: bool) -> NDArray[np.inexact]:
    """Return the filter's factors of the spectral lines of ``size`` rows; read-only.

    Those of a derivative are complex, (L,). Gains are real and apply to real and imaginary parts in turn, (2 L,), which is
    faster.
    """
    frequency = fft.rfftfreq(size, 1.0 / rate)
    gain = lowpass_gain(frequency, bandwidth)
    return gain.astype(complex) * (2j * np.pi * frequency) if derivative else np.repeat(gain, 2)


@lru_cache(maxsize=64)
def _delay_line_factors(size: int, rate: float, late: float) -> NDArray[np.complex128]:
    """Return the factors of the spectral lines of ``size`` rows for a delay [s]; read-only."""
    return np.exp(-2j * np.pi * late * fft.rfftfreq(size, 1.0 / rate))


@lru_cache(maxsize=32)
def _inner_points_of_ramp(rows: int) -> Array:
    """Return a ramp from 0 to 1 without its ends, (rows,); read-only."""
    return np.linspace(0.0, 1.0, rows + 2)[1:-1]


@lru_cache(maxsize=32)
def _weights_of_line_start(rows: int) -> Array:
    """Return the weights (rows,) of the fitted line's first value, ``1/n + x_0 x / (x . x)``; read-only."""
    place = np.arange(rows) - 0.5 * (rows - 1)
    return 1.0 / rows + place[0] * place / (place @ place)


def remove_line(values: Array) -> Array:
    """Return values (..., T) minus the straight line fitted along the last axis."""
    place = np.arange(values.shape[-1]) - 0.5 * (values.shape[-1] - 1)
    slope = values @ place / (place @ place)
    return values - values.mean(axis=-1, keepdims=True) - slope[..., None] * place


def hann_window(rows: int) -> Array:
    """Return the periodic Hann window, (rows,)."""
    return 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, rows + 1)[:-1])


def welch(values: Array, rate: float, rows: int) -> tuple[Array, Array]:
    """Return frequencies [Hz], (L,), and the one-sided spectral density of columns (T, K), (L, K).

    Segments of ``rows`` rows overlap by half and have a Hann window, after removal of a straight line.
    Source: Welch (1967), The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. AU-15.
    """
    window = hann_window(rows)
    segments = np.lib.stride_tricks.sliding_window_view(values.T, rows, axis=-1)[:, :: rows - rows // 2]
    lines = np.asarray(fft.rfft(remove_line(segments) * window, axis=-1))
    power = (lines.real**2 + lines.imag**2).mean(axis=1) / (rate * (window @ window))
    power[:, 1 : (rows + 1) // 2] *= 2.0
    return fft.rfftfreq(rows, 1.0 / rate), power.T


def apply_lag(values: Array, kept: float, start: Array) -> Array:
    """Return the first-order lag of values (T, K) from a start (K,): ``y_n = kept y_(n-1) + (1 - kept) x_(n-1)``."""
    return sum_with_decay(np.concatenate((start[None], (1.0 - kept) * values[:-1])), kept)


def num_edge_rows(rate: float, bandwidth: float) -> int:
    """Return the number of rows at each end that the low-pass may spoil: two periods of its bandwidth, plus one."""
    return round(2.0 * rate / bandwidth) + 1


def without_bad_quaternions(log: FlightLog) -> FlightLog:
    """Return the log without rows whose quaternion is not of norm 1; raise ``DataError`` if these exceed ``MOST_BAD``."""
    norm = np.linalg.norm(log.attitude, axis=1)
    bad = np.abs(norm - 1.0) > NORM_OFF
    if not bad.any():
        return log
    row = int(np.argmax(bad))
    if bad.mean() <= MOST_BAD:
        values = {"rows": int(bad.sum()), "total": bad.size, "times_s": log.time[bad][:SHOWN].tolist()}
        note = Finding("rows_without_quaternion", "", values)
        log = take_rows(log, ~bad)
        return replace(log, notes=(*log.notes, note))
    raise DataError(
        f"{log.row_name(row)}: the attitude quaternion {np.round(log.attitude[row], 4).tolist()} has norm "
        f"{norm[row]:.4g}, must be 1; check that q_x, q_y, q_z, q_w hold a quaternion"
    )


def continuous_quaternion(attitude: Array) -> Array:
    """Return the normalised quaternions (T, 4) with continuous signs."""
    unit = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    return unit * quaternion_signs(unit)[:, None]


def quaternion_signs(attitude: Array) -> Array:
    """Return the signs (T,), +1 or -1, that make quaternions (T, 4) continuous."""
    flips = np.where((attitude[1:] * attitude[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.concatenate(([1.0], np.cumprod(flips)))


def turns_over_rows(attitude: Array, rows: int) -> Array:
    """Return the rotation vectors [rad], body, (T - rows, 3), from each attitude (T, 4) to that so many rows later."""
    turned = _multiply(attitude[:-rows] * (-1.0, -1.0, -1.0, 1.0), attitude[rows:])  # faster than scipy's rotations
    return Rotation.from_quat(turned).as_rotvec()


def integrate_rates(time: Array, ang_vel: Array) -> Array:
    """Return the attitude (T, 4), level at first, from body rates [rad/s], (T, 3), by the mean rate of each step."""
    turns = Rotation.from_rotvec(0.5 * (ang_vel[1:] + ang_vel[:-1]) * np.diff(time)[:, None])
    return _cumulative_products(np.concatenate(([(0.0, 0.0, 0.0, 1.0)], turns.as_quat())))


def _cumulative_products(turns: Array) -> Array:
    """Return the products of all quaternions up to each, (T, 4), xyzw.

    The samples are cut into blocks of equal length. All blocks advance together, and are then joined one after the other.
    """
    length = max(int(np.sqrt(turns.shape[0])), 1)
    number = -(-turns.shape[0] // length)
    rest = np.tile((0.0, 0.0, 0.0, 1.0), (number * length - turns.shape[0], 1))
    blocks = np.concatenate((turns, rest)).reshape(number, length, 4)
    for i in range(1, length):
        blocks[:, i] = _multiply(blocks[:, i - 1], blocks[:, i])
    for block in range(1, number):
        blocks[block] = _multiply(blocks[block - 1, -1], blocks[block])
    results = blocks.reshape(-1, 4)[: turns.shape[0]]
    return results / np.sqrt(np.einsum("ij,ij->i", results, results))[:, None]


def _multiply(first: Array, second: Array) -> Array:
    """Return the quaternion products ``first second``, (..., 4), xyzw."""
    a, b = first[..., :3], second[..., :3]
    vector = first[..., 3:] * b + second[..., 3:] * a + np.cross(a, b)
    scalar = first[..., 3:] * second[..., 3:] - np.sum(a * b, axis=-1, keepdims=True)
    return np.concatenate((vector, scalar), axis=-1)


def interpolate_columns(at: Array, time: Array, values: Array) -> Array:
    """Return columns (T, K) interpolated linearly at other times."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def interpolate_by_spline(at: Array, time: Array, values: Array) -> Array:
    """Return columns (T, K) at other times by a cubic spline; by lines across gaps and near close samples, constant outside.

    Straight lines between samples halve the power of white noise, most at high frequencies, where the noise of a sensor is
    measured. They also weaken motion, at a fifth of the rate by 12 %; the spline weakens it by 1 %.
    """
    step = np.diff(time)
    line = interpolate_columns(at, time, values)
    if time.size < 4:
        return line
    inside, before = np.clip(at, time[0], time[-1]), np.clip(np.searchsorted(time, at, "right") - 1, 0, step.size - 1)
    usual = float(np.median(step))
    close = ndimage.binary_dilation(
        step < usual / GAP_STEPS, iterations=2
    )  # a slope between close samples is mostly noise
    gap = np.logical_or(step > GAP_STEPS * usual, close)
    return np.where(gap[before][:, None], line, CubicSpline(time, values)(inside))


def mean_of_held_values(rows: Array, time: Array, values: Array, step: float) -> Array:
    """Return the means over each row's step [s] of values (T, K) that hold until the next sample."""
    ends = np.append(rows[1:], rows[-1] + step)
    begins = np.append(time, max(time[-1], ends[-1]) + step)
    total = np.concatenate((np.zeros((1, values.shape[1])), np.cumsum(values * np.diff(begins)[:, None], axis=0)))
    both = interpolate_columns(np.append(rows, ends).clip(time[0]), begins, total)
    lengths = np.subtract(*np.split(np.append(rows, ends).clip(time[0]), 2)[::-1])
    means = np.subtract(*np.split(both, 2)[::-1]) / np.maximum(lengths, 1e-12)[:, None]
    return np.where(lengths[:, None] > 0.0, means, values[:1])


def check_gaps(log: FlightLog) -> None:
    """Raise ``DataError`` if a time gap cannot be bridged, such as one left by bad quaternions."""
    steps = np.diff(log.time)
    step = float(np.median(steps))
    gap = int(np.argmax(steps))
    if steps[gap] > longest_bridgeable_gap(step):
        raise DataError(
            f"{log.row_name(gap + 1)}: {steps[gap]:.3g} s after the row before, where {step:.3g} s are usual; "
            "cut the log there and give both parts as flights"
        )


def log_at_equal_steps(log: FlightLog) -> FlightLog:
    """Return the log at equal time steps with unit quaternions of continuous sign; gaps are marked.

    A command holds until the next one: each row has its mean until the next row.

    Raise ``DataError`` if a gap cannot be bridged.
    """
    check_gaps(log)
    steps = np.diff(log.time)
    step = float(np.median(steps))
    attitude = continuous_quaternion(log.attitude)
    if np.abs(steps - step).max() <= 0.1 * step:
        return replace(log, attitude=attitude)
    count = int((log.time[-1] - log.time[0]) / step) + 1
    time = log.time[0] + step * np.arange(count)
    columns = {name: values for name, values in row_arrays(log).items() if values.ndim == 2} | {"attitude": attitude}
    moved = {
        name: (interpolate_by_spline if name in IN_BAND else interpolate_columns)(time, log.time, values)
        for name, values in columns.items()
    }
    moved["attitude"] = continuous_quaternion(moved["attitude"])
    if log.rotor_command is not None:
        moved["rotor_command"] = mean_of_held_values(time, log.time, log.rotor_command, step)
    if log.battery is not None:
        moved["battery"] = np.interp(time, log.time, log.battery)
    span = {"shortest_s": float(steps.min()), "longest_s": float(steps.max()), "step_s": step}
    notes = [*log.notes, Finding("steps_resampled", "", span)]
    before = np.clip(np.searchsorted(log.time, time, "right") - 1, 0, steps.size - 1)
    lost = (steps > GAP_STEPS * step)[before] & (time > log.time[before])
    if lost.any():
        notes.append(Finding("rows_lost", "", {"share": float(lost.mean()), "longest_s": float(steps.max())}))
    return replace(log, **moved, time=time, lost=lost if lost.any() else None, lines=None, notes=tuple(notes))
