"""Delays of rotor speeds and commands behind the gyro, without a model of the vehicle.

Squared rotor speeds give the angular acceleration about x and y by coefficients that a fit finds; the delay is common to both.
Commands lead the motion by the rotor lag: their delay is that of their clock less the lag, and no flight tells both apart.
Letters: T rows, R rotors, O outputs, G groups of rows, P parameters.
"""

import numpy as np
from scipy import fft

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.logs.checks.kinematics import BLOCK_S
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import DERIVED_BAND, interpolate_columns, lowpass, num_edge_rows
from aerial_gym.sim2real.statistics import student_quantile

ROTOR_BANDWIDTH_HZ = 10.0  # Upper end of the comparison, where rotors turn the body more than the air does
SLOWEST_SHARE = 0.05  # Lower end of the comparison as a share of the upper one: slow torques are of other causes
LEAST_EXPLAINED = 0.5  # Least share of the variance of an output that the rotors explain at the best delay
TRIAL_S = 0.01  # Distance of the delays of the search [s]: a tenth of the shortest period
GROUPS = 8  # Parts of a flight that are left out in turn; residuals of each, at least BLOCK_S long, are independent
LOBE_S = 0.05  # Distance within which delays fit alike [s]: half of the shortest period
STEPS = 3  # Linear fits about the best delay of the search


def rotor_delay(log: FlightLog, rotors: Array, largest: float) -> tuple[float, float] | None:
    """Return the delay of rotor speeds or commands (T, R) and the half width of its 95 % interval [s]; positive: they are late.

    The flight has equal steps. None if its motion does not show the delay. ``largest``: largest delay of the search [s].
    """
    rate = sample_rate(log)
    band = min(ROTOR_BANDWIDTH_HZ, DERIVED_BAND * rate)
    edge = num_edge_rows(rate, band) + round(largest * rate)
    if log.ang_vel is None or len(rotors) - 2 * edge < GROUPS * BLOCK_S * rate:
        return None
    turning = lowpass(log.ang_vel[:, :2], rate, DERIVED_BAND * rate, derivative=True)
    outputs, squares = (_band_pass(values, rate, band) for values in (turning, rotors**2))
    shifts = np.arange(-round(largest * rate), round(largest * rate) + 1, max(1, round(TRIAL_S * rate)))
    inner = slice(edge, len(outputs) - edge)
    left = _shares_left(outputs, squares, inner, shifts)
    explained = left.min(axis=0) < 1.0 - LEAST_EXPLAINED
    best = int(np.argmin(left[:, explained].sum(axis=1)))
    if not explained.any() or best in (0, shifts.size - 1):
        return None
    far = np.abs(shifts - shifts[best]) > LOBE_S * rate
    rival = int(shifts[far][np.argmin(left[far][:, explained].sum(axis=1))])
    if not _fits_better(outputs[:, explained], squares, inner, (int(shifts[best]), rival)):
        return None
    refined = _refine(outputs[:, explained], squares, inner, float(shifts[best]) / rate, rate)
    return (
        None if refined is None or refined[1] > largest else refined
    )  # an interval as wide as the search shows nothing


def _band_pass(values: Array, rate: float, band: float) -> Array:
    return lowpass(values, rate, band) - lowpass(values, rate, SLOWEST_SHARE * band)


def _shares_left(outputs: Array, squares: Array, inner: slice, shifts: Indices) -> Array:
    """Return the shares of outputs (T, O) that squared speeds (T, R) at each shift [rows] do not explain, (shifts, O)."""
    target = np.zeros_like(outputs)
    target[inner] = outputs[inner]
    size = int(fft.next_fast_len(len(outputs), real=True) or 0)
    lines = [np.asarray(fft.rfft(values, n=size, axis=0)) for values in (squares, target)]
    products = np.asarray(fft.irfft(lines[0][:, :, None] * lines[1].conj()[:, None], n=size, axis=0))[shifts]
    inverse = np.linalg.pinv(squares[inner].T @ squares[inner])  # the same for all shifts, nearly
    explained = np.einsum("nro,rq,nqo->no", products, inverse, products)
    return 1.0 - explained / np.sum(target**2, axis=0).clip(1e-300)


def _fits_better(outputs: Array, squares: Array, inner: slice, shifts: tuple[int, int]) -> bool:
    """Return whether squared speeds at the first shift [rows] explain more than at the second, by a t test over groups."""
    target, sums = outputs[inner] / np.sqrt(np.mean(outputs[inner] ** 2, axis=0)).clip(1e-300), []
    for shift in shifts:
        speed = squares[inner.start + shift : inner.stop + shift]
        errors = target - speed @ np.linalg.lstsq(speed, target, rcond=None)[0]
        sums.append([float(np.sum(part**2)) for part in np.array_split(errors, GROUPS)])
    rise = np.subtract(sums[1], sums[0])
    return float(rise.mean()) > student_quantile(0.975, GROUPS - 1) * float(rise.std(ddof=1)) / np.sqrt(GROUPS)


def _refine(outputs: Array, squares: Array, inner: slice, delay: float, rate: float) -> tuple[float, float] | None:
    """Return the delay near that of the search by least squares, and its half width by the jackknife over groups of rows.

    Source: Efron, Tibshirani (1993), An Introduction to the Bootstrap, chapter 11; groups allow for correlated residuals.
    """
    time, slopes, start = np.arange(len(outputs)) / rate, np.gradient(squares, 1.0 / rate, axis=0), delay
    target, number = outputs[inner], outputs.shape[1]
    for _ in range(STEPS):
        speed, slope = (interpolate_columns(time + delay, time, values)[inner] for values in (squares, slopes))
        gains = np.linalg.lstsq(speed, target, rcond=None)[0]
        errors = target - speed @ gains
        errors_rms = np.sqrt(np.mean(errors**2, axis=0)).clip(1e-9 * np.abs(target).max())
        causes = np.zeros((number, len(target), number * speed.shape[1] + 1))
        for output in range(number):
            causes[output, :, output * speed.shape[1] : (output + 1) * speed.shape[1]] = speed / errors_rms[output]
            causes[output, :, -1] = slope @ gains[:, output] / errors_rms[output]
        rows = (np.array_split(values, GROUPS, axis=1) for values in (causes, (errors / errors_rms).T[..., None]))
        pairs = [(a.reshape(-1, a.shape[-1]), b.reshape(-1)) for a, b in zip(*rows, strict=True)]
        normal, sides = zip(*((a.T @ a, a.T @ b) for a, b in pairs), strict=True)
        whole, side = np.sum(normal, axis=0), np.sum(sides, axis=0)
        delay += float((np.linalg.pinv(whole) @ side)[-1])
    if abs(delay - start) > 2.0 * TRIAL_S:
        return None
    partial_steps = [(np.linalg.pinv(whole - a) @ (side - b))[-1] for a, b in zip(normal, sides, strict=True)]
    spread = np.sqrt((GROUPS - 1.0) * np.var(partial_steps))
    return delay, float(student_quantile(0.975, GROUPS - 1) * spread)
