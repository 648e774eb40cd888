"""Filters of second order on three axes: low-passes and notches, in direct form II. Pure functions of tensors.

Letters: E environments.
"""

from dataclasses import dataclass
from math import cos, pi, tan

import torch
from torch import Tensor


@dataclass(frozen=True)
class Biquad:
    """Coefficients of ``y = (b0 + b1 / z + b2 / z²) / (1 + a1 / z + a2 / z²) x``."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


def butterworth(cutoff_hz: float, rate_hz: float) -> Biquad | None:
    """Return the Butterworth low-pass of second order for a cut-off and sampling rate; None for a cut-off of 0.

    Source: bilinear transform of ``1 / (s² + sqrt 2 s + 1)``, e.g. Oppenheim, Schafer (2010), Discrete-Time Signal Processing,
    7.3; PX4, ``LowPassFilter2p``.
    """
    if cutoff_hz == 0.0:
        return None
    warped = tan(pi * cutoff_hz / rate_hz)
    scale = 1.0 + 2.0 * cos(0.25 * pi) * warped + warped**2
    b0 = warped**2 / scale
    return Biquad(
        b0, 2.0 * b0, b0, 2.0 * (warped**2 - 1.0) / scale, (1.0 - 2.0 * cos(0.25 * pi) * warped + warped**2) / scale
    )


def notch(frequency_hz: float, bandwidth_hz: float, rate_hz: float) -> Biquad | None:
    """Return the notch filter of a frequency; None for a frequency of 0.

    The width between its half-power frequencies is ``bandwidth_hz`` at any rate.

    Source: Regalia, Mitra, Vaidyanathan (1988), The digital all-pass filter: a versatile signal processing building block,
    section III: half the sum of a signal and its second-order all-pass; PX4, ``NotchFilter``.
    """
    if frequency_hz == 0.0:
        return None
    width, turn = tan(pi * bandwidth_hz / rate_hz), -2.0 * cos(2.0 * pi * frequency_hz / rate_hz)
    b0 = 1.0 / (1.0 + width)
    return Biquad(b0, turn * b0, b0, turn * b0, (1.0 - width) * b0)


def apply_filter(sample: Tensor, kept: Tensor, begins: Tensor, filter: Biquad) -> tuple[Tensor, Tensor]:
    """Return the filtered sample (E, 3) and the new filter state, (E, 6); a new filter starts in steady state at its sample.

    Args:
        sample: (E, 3).
        kept: The last two inner values, (E, 6).
        begins: Whether this is the first sample, bool (E, 1).
    """
    resting = sample / (1.0 + filter.a1 + filter.a2)
    first, second = (torch.where(begins, resting, part) for part in kept.split(3, dim=-1))
    inner = sample - filter.a1 * first - filter.a2 * second
    return filter.b0 * inner + filter.b1 * first + filter.b2 * second, torch.cat((inner, first), dim=-1)
