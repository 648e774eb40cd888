"""Zero-phase low-pass, derivatives, uniform time and the clock of the rotor log.

Everything here uses future samples: it is for logs, not for flight. Letters: T rows.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from aerial_gym.errors import DataError
from aerial_gym.sim2real.flight_log import FlightLog

Array = NDArray[np.float64]

FILTER_ORDER = 4
"""Order of the Butterworth low-pass that is run forwards and backwards."""

LONGEST_GAP_ROWS = 5
"""A gap of more rows than this, and of more than LONGEST_GAP_S, ends a flight."""

LONGEST_GAP_S = 0.1
"""[s]."""

LOOSE_END = 0.05
"""Rows beyond a gap are cut off if they are no more than this share of a log."""

LARGEST_SHIFT_S = 0.05
"""Clock offsets of the rotor log are looked for up to this [s]; measured_data.md 2: 0 to 0.03 s."""

SETTLED = 5.0
"""A lag has forgotten where it began after so many declared time constants."""

LEAST_SHIFT_GAIN = 0.3
"""A shift must take this share off the variance that is left, else the clock is believed. One row of a 100 Hz log or
vertical drag takes off less; a lead of two rows takes off half (seen on the IDSIA flights)."""


def lowpass_gain(frequency: Array, bandwidth: float) -> Array:
    """Return the gain ``1 / (1 + (f / b)^8)`` of a Butterworth low-pass of order 4 run forwards and backwards.

    Source: Oppenheim, Schafer (2010), Discrete-Time Signal Processing, B.1: the squared magnitude of a Butterworth filter.
    """
    return 1.0 / (1.0 + (frequency / bandwidth) ** (2 * FILTER_ORDER))


def lowpass(values: Array, rate: float, bandwidth: float, *, derivative: bool = False) -> Array:
    """Return ``values`` low-passed without phase, or their time derivative in the same band.

    The ends are continued by point reflection about the line through the last half period, so that a level or a slope does
    not ring and noise in the last row does not bend the end; rows within ``edge_rows`` should not be used all the same.

    Args:
        values: Samples at equal steps, (T, ...).
        rate: Samples per second [Hz].
        bandwidth: Frequency of half gain [Hz].
        derivative: Whether to multiply by ``2 pi i f``.
    """
    rows = values.shape[0]
    pad = min(rows - 1, 3 * edge_rows(rate, bandwidth))
    span = min(rows, max(2, round(0.5 * rate / bandwidth)))
    head = 2.0 * _end_value(values[:span]) - values[pad:0:-1]
    tail = 2.0 * _end_value(values[: -span - 1 : -1]) - values[-2 : -pad - 2 : -1]
    longer = np.concatenate((head, values, tail))
    size = int(fft.next_fast_len(longer.shape[0] + pad, real=True) or 0)
    # The remaining gap of the circle is closed by a straight line, so that it adds no jump.
    blend = np.linspace(0.0, 1.0, size - longer.shape[0] + 2)[1:-1].reshape(-1, *(1,) * (values.ndim - 1))
    circle = np.concatenate((longer, longer[-1:] * (1.0 - blend) + longer[:1] * blend))
    frequency = fft.rfftfreq(size, 1.0 / rate)
    gain = lowpass_gain(frequency, bandwidth).astype(complex)
    if derivative:
        gain *= 2j * np.pi * frequency
    spectrum = np.asarray(fft.rfft(circle, axis=0)) * gain.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(fft.irfft(spectrum, n=size, axis=0))[pad : pad + rows]


def _end_value(values: Array) -> Array:
    """Return the value at the first row of the line fitted through some rows, (1, ...)."""
    place = np.arange(values.shape[0]) - 0.5 * (values.shape[0] - 1)
    slope = np.tensordot(place, values, axes=(0, 0)) / (place @ place)
    return (values.mean(axis=0) + place[0] * slope)[None]


def edge_rows(rate: float, bandwidth: float) -> int:
    """Return the number of rows at each end that the low-pass may spoil: two periods of its bandwidth."""
    return round(2.0 * rate / bandwidth) + 1


def continuous_quaternion(attitude: Array) -> Array:
    """Return unit quaternions (T, 4) of the same attitudes without jumps of sign from row to row."""
    unit = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    flips = np.cumprod(np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    return unit * np.concatenate(([1.0], flips))[:, None]


def without_gaps(log: FlightLog) -> FlightLog:
    """Return the log without a short piece at either end that a gap in time cuts off.

    Raises:
        DataError: If rows are missing for longer than can be bridged.
    """
    log = _without_loose_ends(log)
    steps = np.diff(log.time)
    step = float(np.median(steps))
    gap = int(np.argmax(steps))
    if steps[gap] > max(LONGEST_GAP_ROWS * step, LONGEST_GAP_S):
        raise DataError(
            f"{log.where(gap + 1)}: {steps[gap]:.3g} s after the row before, where {step:.3g} s are usual; "
            "cut the log there and give both parts as flights"
        )
    return log


def uniform_log(log: FlightLog) -> FlightLog:
    """Return the log with equal time steps and unit quaternions without jumps of sign; commands stay held.

    Raises:
        DataError: If rows are missing for longer than can be bridged.
    """
    log = without_gaps(log)
    steps = np.diff(log.time)
    step = float(np.median(steps))
    attitude = continuous_quaternion(log.attitude)
    if np.abs(steps - step).max() <= 0.1 * step:
        return replace(log, attitude=attitude)
    count = int((log.time[-1] - log.time[0]) / step) + 1
    time = log.time[0] + step * np.arange(count)

    def line(values: Array | None) -> Array | None:
        if values is None:
            return None
        return np.stack([np.interp(time, log.time, column) for column in values.T], axis=1)

    before = np.clip(np.searchsorted(log.time, time, side="right") - 1, 0, None)
    moved = line(attitude)
    assert moved is not None
    return replace(
        log,
        time=time,
        attitude=continuous_quaternion(moved),
        position=line(log.position),
        lin_vel=line(log.lin_vel),
        ang_vel=line(log.ang_vel),
        specific_force=line(log.specific_force),
        rotor_speed=line(log.rotor_speed),
        rotor_command=None if log.rotor_command is None else log.rotor_command[before],
        battery=None if log.battery is None else np.interp(time, log.time, log.battery),
        other_position=line(log.other_position),
        notes=(*log.notes, f"unequal time steps ({steps.min():.3g} to {steps.max():.3g} s) resampled to {step:.3g} s"),
    )


def _without_loose_ends(log: FlightLog) -> FlightLog:
    """Return the log without a short piece at either end that a gap cuts off, and say so."""
    steps = np.diff(log.time)
    limit = max(LONGEST_GAP_ROWS * float(np.median(steps)), LONGEST_GAP_S)
    edges = [0, *(np.flatnonzero(steps > limit) + 1).tolist(), log.time.size]
    sizes = np.diff(edges)
    longest = int(np.argmax(sizes))
    if len(sizes) == 1 or sizes[longest] < (1.0 - LOOSE_END) * log.time.size:
        return log
    part = slice(edges[longest], edges[longest + 1])
    arrays = {f.name: value[part] for f in fields(log) if isinstance(value := getattr(log, f.name), np.ndarray)}
    note = f"{log.time.size - sizes[longest]} rows beyond a gap of {steps.max():.3g} s at the end or start were cut off"
    return replace(log, **arrays, notes=(*log.notes, note))


PASSED = 0.85
"""Share of the band whose noise is left between both low-passes: ``7/8 (pi/8) / sin(pi/8)`` of the upper, less 0.05 of it."""


@dataclass(frozen=True, kw_only=True)
class Lead:
    """By how much the rotor log is ahead of the other sensors."""

    rows: float = 0.0
    std: float = 0.0
    """Standard deviation [rows]."""


def rotor_log_lead(measured: Array, predicted: Array, others: Array, rate: float, bandwidth: float) -> Lead:
    """Return by how many rows the rotor log leads the other sensors; 0 unless a shift clearly agrees better.

    Thrust explains the specific force along z up to a factor, drag and a shifted centre of mass up to others; what is
    left, S, is compared between shifts. Between rows its least is that of a parabola, and it is known to ``sqrt(2 S / n S'')``
    with n independent samples, two per second and hertz of what the filters pass.

    Args:
        measured: Specific force along body z [m/s²], (T,).
        predicted: The same, predicted from the logged rotor speeds, (T,).
        others: What else may act along z, on the clock of the accelerometer, (T, any): velocity, angular acceleration.
        rate: Rows per second [Hz].
        bandwidth: The comparison is made below it and above a twentieth of it [Hz].
    """
    most = round(LARGEST_SHIFT_S * rate)
    wave = np.column_stack((measured, predicted, others))
    wave = lowpass(wave, rate, bandwidth) - lowpass(wave, rate, 0.05 * bandwidth)
    edge = edge_rows(rate, bandwidth) + most
    inner = slice(edge, -edge)
    target = wave[inner, 0]
    if target.size < 4 * edge or not np.any(target):
        return Lead()

    def left(lead: int) -> float:
        causes = np.column_stack((np.roll(wave[:, 1], lead)[inner], wave[inner, 2:]))
        gains = np.linalg.lstsq(causes, target, rcond=None)[0]
        return float(np.sum((target - causes @ gains) ** 2) / np.sum(target**2))

    unmoved = left(0)
    best = min(range(-most, most + 1), key=left)
    # The least at an end of the range is no least: something else grows with the shift.
    if abs(best) == most or left(best) >= (1.0 - LEAST_SHIFT_GAIN) * unmoved or left(best) >= 0.5:
        return Lead()
    before, least, after = (left(best + place) for place in (-1, 0, 1))
    curvature = before - 2.0 * least + after
    samples = 2.0 * PASSED * bandwidth * target.size / rate
    least -= (before - after) ** 2 / (8.0 * curvature)
    return Lead(
        rows=best + 0.5 * (before - after) / curvature,
        std=float(np.sqrt(2.0 * least / (samples * curvature))),
    )


def commands_lead_too(log: FlightLog, lead: Lead, time_constant: float) -> bool:
    """Return whether commands are on the clock of the rotor speeds, rather than on that of the other sensors.

    A lag is no shift: the clock is the one on which a first-order lag, of any time constant, makes the measured speeds out of
    the commands. Unless the other one leaves clearly less, it is that of the rotor speeds.

    Args:
        log: With rotor speeds that lead the other sensors by ``lead``.
        lead: Of the rotor speeds.
        time_constant: Declared [s]; a fifth to five times of it is tried.
    """
    speed, command = log.rotor_speed, log.rotor_command
    if lead.rows == 0.0 or speed is None or command is None:
        return True
    whole = round(lead.rows)
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    edge = round(SETTLED * time_constant / step) + abs(whole)

    def left(shift: int) -> float:
        moved, found = np.roll(command, shift, axis=0), []
        for constant in time_constant * np.geomspace(0.2, 5.0, 17):
            kept = np.exp(-step / constant)
            follow, _ = signal.lfilter([0.0, 1.0 - kept], [1.0, -kept], moved, axis=0, zi=speed[:1])
            found.append(np.mean((speed - follow)[edge:-edge] ** 2))
        return float(min(found))

    return left(-whole) > (1.0 - LEAST_SHIFT_GAIN) * left(0)


def shift_rotor_log(log: FlightLog, lead: Lead, *, commands: bool = True) -> FlightLog:
    """Return the log with rotor speeds, and commands, moved to the later by ``lead``, the ends cut off.

    Between rows they run in a straight line; of a command that is held from row to row this is the mean.
    """
    if lead.rows == 0.0:
        return log
    rows, whole = np.arange(log.time.size), int(np.ceil(abs(lead.rows)))
    kept = slice(whole, None) if lead.rows > 0.0 else slice(0, -whole)
    arrays = {f.name: value[kept] for f in fields(log) if isinstance(value := getattr(log, f.name), np.ndarray)}
    for name in ("rotor_speed", "rotor_command")[: 1 + commands]:
        values = getattr(log, name)
        if values is not None:
            arrays[name] = np.stack([np.interp(rows[kept] - lead.rows, rows, column) for column in values.T], axis=1)
    step = 1e3 * float(np.median(np.diff(log.time)))
    other = "" if commands else "; commands do not and stay"
    ahead = f"{lead.rows * step:.3g} ± {1.96 * lead.std * step:.2g} ms"
    note = f"rotor log leads the other sensors by {ahead} and was moved back{other}"
    return replace(log, **arrays, notes=(*log.notes, note))
