"""How the scatter of signals of a flight is spread over frequencies, where it is quietest, and filters without phase.

Letters: T rows, L lines of a spectrum, K columns.
"""

import numpy as np
from scipy import fft

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.signals import hann, welch

SEGMENT_S = 2.0
"""Length of a segment of Welch's spectrum [s]."""

OCTAVE = 2.0
"""Width of the bands of which the quietest gives the noise."""

FROM_BAND, TO_BAND = 1.5, 6.0
"""They lie between these multiples of the bandwidth: near it, for a log that was resampled has less noise far above it."""

TO_RATE = 0.45
"""And below this share of the rate."""


def segment_length(rows: int, rate: float) -> int:
    """Return how many rows a segment has."""
    return min(rows, round(SEGMENT_S * rate))


def density_of(values: Array, rate: float) -> tuple[Array, Array]:
    """Return the frequencies [Hz], (L,), and the density of each column (T, any) there, level for white noise."""
    length = segment_length(len(values), rate)
    frequency, density = welch(values, rate, length)
    return frequency, density / _seen_without_line(length)[:, None]


def _seen_without_line(length: int) -> Array:
    """Return what is seen of white noise in each line of a segment, (L,), when the straight line through it is taken out.

    Derived: of a row x of white noise, line k is ``v_k (x - P x)``, P the projection on straight lines, v_k the windowed wave;
    its mean square is ``|v_k - P v_k|² = |v_k|² - |P v_k|²``.
    """
    window = hann(length)
    place = np.arange(length) - 0.5 * (length - 1)
    lost = sum(np.abs(np.fft.rfft(window * one)) ** 2 / (one @ one) for one in (np.ones(length), place))
    return 1.0 - lost / (window @ window)


def noise_above(frequency: Array, density: Array, bandwidth: float, rate: float) -> tuple[Array, float] | None:
    """Return the level of the noise of each column, (K,), and how many lines it is the mean of at least.

    The mean density of the quietest octave above a band [Hz]: white noise is nowhere more than the whole. None where the log
    has no octave there.
    """
    low, high = FROM_BAND * bandwidth, min(TO_BAND * bandwidth, TO_RATE * rate)
    places = np.flatnonzero((frequency >= low) & (OCTAVE * frequency <= high))
    if not places.size:
        return None
    means = [density[place : round(OCTAVE * place)].mean(axis=0) for place in places]
    return np.min(means, axis=0), (OCTAVE - 1.0) * float(places[0])


def filtered(values: Array, frequency: Array, gain: Array, rate: float) -> Array:
    """Return columns (T, R) with a gain (L, R) at each frequency, without phase."""
    mirrored = np.concatenate((values, values[::-1]))
    at = fft.rfftfreq(len(mirrored), 1.0 / rate)
    gains = np.stack([np.interp(at, frequency, one) for one in gain.T], axis=1)
    spectrum = np.asarray(fft.rfft(mirrored, axis=0))
    return np.asarray(fft.irfft(spectrum * gains, n=len(mirrored), axis=0))[: len(values)]
