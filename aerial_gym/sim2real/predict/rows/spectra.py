"""Spectral densities of flight signals, their noise level and zero-phase filters.

Letters: T rows, L lines of a spectrum, K columns.
"""

import numpy as np
from scipy import fft

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.signals import hann_window, welch

SEGMENT_S = 2.0  # Length of a segment of Welch's spectrum [s]
OCTAVE = 2.0  # Frequency ratio of the bands among which the quietest gives the noise
FROM_BAND, TO_BAND = 1.5, 6.0  # Range of these bands in bandwidths, as resampled logs have less noise above
TO_RATE = 0.45  # Upper limit of these bands as a share of the rate


def segment_length(rows: int, rate: float) -> int:
    """Return the number of rows per segment."""
    return min(rows, round(SEGMENT_S * rate))


def power_density(values: Array, rate: float) -> tuple[Array, Array]:
    """Return the frequencies [Hz], (L,), and the density of each column (T, any), flat for white noise."""
    length = segment_length(len(values), rate)
    frequency, density = welch(values, rate, length)
    return frequency, density / _white_noise_gain(length)[:, None]


def _white_noise_gain(length: int) -> Array:
    """Return the gain of Welch's density for white noise, ``|v_k - P v_k|²`` of wave v_k without lines P, over |v_k|², (L,)."""
    window = hann_window(length)
    place = np.arange(length) - 0.5 * (length - 1)
    lost = sum(np.abs(np.fft.rfft(window * one)) ** 2 / (one @ one) for one in (np.ones(length), place))
    return 1.0 - lost / (window @ window)


def noise_level(frequency: Array, density: Array, bandwidth: float, rate: float) -> tuple[Array, float] | None:
    """Return the density of each column in its quietest octave above the band [Hz], (K,), and its least number of lines."""
    low, high = FROM_BAND * bandwidth, min(TO_BAND * bandwidth, TO_RATE * rate)
    places = np.flatnonzero((frequency >= low) & (OCTAVE * frequency <= high))
    if not places.size:
        return None
    means = [density[place : round(OCTAVE * place)].mean(axis=0) for place in places]
    return np.min(means, axis=0), (OCTAVE - 1.0) * float(places[0])


def filter_by_gain(values: Array, frequency: Array, gain: Array, rate: float) -> Array:
    """Return columns (T, R) filtered with a gain (L, R) by frequency, without phase shift."""
    mirrored = np.concatenate((values, values[::-1]))
    at = fft.rfftfreq(len(mirrored), 1.0 / rate)
    gains = np.stack([np.interp(at, frequency, one) for one in gain.T], axis=1)
    spectrum = np.asarray(fft.rfft(mirrored, axis=0))
    return np.asarray(fft.irfft(spectrum * gains, n=len(mirrored), axis=0))[: len(values)]
