"""Whiteness: the power of a residual by octave below the bandwidth, and a test for equal power at all frequencies.

Letters: T rows, C channels, O octaves, L spectral lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import special
from scipy.integrate import cumulative_trapezoid

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.json_values import select_fields
from aerial_gym.sim2real.logs.signals import lowpass_gain, remove_line
from aerial_gym.sim2real.predict.channels import Channel

EDGES = (0.0, 0.125, 0.25, 0.5, 1.0)
"""Edges of the octaves as shares of the bandwidth; the lowest octave extends down to zero."""

FEWEST_ROWS = 64  # Fewest rows of a span without a gap that enters the spectrum

DIFFERENTIATED = ("angular_acceleration", "kinematic_force")
"""Kinds of channel that are derivatives of a reading: white noise of the sensor grows with the square of the frequency."""

WHITE = 0.01  # Smallest p-value at which a residual counts as white


@dataclass(frozen=True, kw_only=True)
class Whiteness:
    """Distribution of a residual's power over frequency, with a test against white noise."""

    probability: float  # P-value: the probability that white noise is distributed as unevenly
    octaves: tuple[float, ...]  # Power in each octave divided by that of white noise with the same total power, (O,)

    @property
    def white(self) -> bool:
        """Return whether the residual may be white noise."""
        return self.probability >= WHITE

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return select_fields(self, "probability", "white", "octaves")


def periodogram_of_flights(
    times: Sequence[Array], values: Sequence[Array], bandwidth: float, *, tapered: bool = False
) -> tuple[Array, Array]:
    """Return frequencies (L,) [Hz] and powers (L, C) of all spans without a gap, with the low-pass gain divided out.

    Args:
        times: Times of the rows of each flight [s], (T,), at equal steps except for gaps.
        values: Values of each flight, (T, C), low-passed at ``bandwidth``.
        tapered: Whether a Hann window limits leakage from strong low frequencies; neighbouring lines then correlate.
    """
    frequencies, powers = [np.zeros(0)], [np.zeros((0, values[0].shape[1]))]
    for time, rows in zip(times, values, strict=True):
        step = float(np.median(np.diff(time)))
        for part in np.split(rows, np.flatnonzero(np.diff(time) > 1.5 * step) + 1):
            if part.shape[0] < FEWEST_ROWS:
                continue
            frequency = np.fft.rfftfreq(part.shape[0], step)
            window = np.sqrt(8.0 / 3.0) * np.hanning(part.shape[0])[:, None] if tapered else 1.0
            power = np.abs(np.fft.rfft(window * part, axis=0)) ** 2 / part.shape[0]
            inside = (frequency > 0.0) & (frequency <= bandwidth)
            frequencies.append(frequency[inside])
            powers.append(power[inside] / lowpass_gain(frequency[inside], bandwidth)[:, None] ** 2)
    return np.concatenate(frequencies), np.concatenate(powers)


def integrals_over_time(times: Sequence[Array], values: Sequence[Array]) -> list[Array]:
    """Return the integrals of values (T, C): trapezoidal rule, with its gain ``(w h/2) cot(w h/2)`` divided out."""
    results = []
    for time, rows in zip(times, values, strict=True):
        step = float(np.median(np.diff(time)))
        total = remove_line(cumulative_trapezoid(rows.T, dx=step, initial=0.0)).T
        angle = np.pi * np.fft.rfftfreq(len(rows), 1.0)  # w h / 2
        gain = np.ones_like(angle)
        gain[1:] = np.maximum(angle[1:] / np.tan(np.maximum(angle[1:], 1e-12)), 0.1)  # limited above the band
        results.append(np.fft.irfft(np.fft.rfft(total, axis=0) / gain[:, None], n=len(rows), axis=0))
    return results


def power_by_octave(frequency: Array, power: Array, bandwidth: float) -> Array:
    """Return the power in each octave, (O, C)."""
    place = np.clip(np.digitize(frequency / bandwidth, EDGES[1:], right=True), 0, len(EDGES) - 2)
    return np.stack([power[place == octave].sum(axis=0) for octave in range(len(EDGES) - 1)])


def octave_ranges(bandwidth: float) -> list[str]:
    """Return the frequency range of each octave as text."""
    return [f"{low * bandwidth:.3g} to {high * bandwidth:.3g} Hz" for low, high in pairwise(EDGES)]


def whiteness_of_channels(
    times: Sequence[Array], residuals: Sequence[Array], channels: Sequence[Channel], bandwidth: float
) -> list[Whiteness]:
    """Return the whiteness of each channel of residuals (T, C); channels that are derivatives are integrated first.

    The test is that of Kolmogorov and Smirnov for the distance of the cumulative periodogram from a straight line.
    Source: Durbin (1969), Tests for serial correlation in regression analysis based on the periodogram of least-squares
    residuals, Biometrika 56; finite samples: Stephens (1970), JRSS B 32.
    """
    frequency, power = periodogram_of_flights(times, residuals, bandwidth)
    read = periodogram_of_flights(times, integrals_over_time(times, residuals), bandwidth)[1]
    order, count = np.argsort(frequency), frequency.size
    results = []
    for place, channel in enumerate(channels):
        if count < 2 * len(EDGES):
            results.append(Whiteness(probability=1.0, octaves=(1.0,) * (len(EDGES) - 1)))
            continue
        even = (read if channel.kind in DIFFERENTIATED else power)[:, place]
        total = np.cumsum(even[order]) / even.sum()
        distance = float(np.abs(total - np.arange(1, count + 1) / count).max())
        root = np.sqrt(count)
        share = power_by_octave(frequency, even[:, None], bandwidth)[:, 0] / even.sum()
        number = power_by_octave(frequency, np.ones((count, 1)), bandwidth)[:, 0] / count
        results.append(
            Whiteness(
                probability=float(special.kolmogorov(distance * (root + 0.12 + 0.11 / root))),
                octaves=tuple((share / np.maximum(number, 1e-300)).tolist()),
            )
        )
    return results
