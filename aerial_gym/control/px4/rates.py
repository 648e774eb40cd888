"""PX4's rate controller and its filters: pure functions of tensors.

Frames: body is x forward, y left, z up. PX4's are y right and z down, which changes two signs of everything alike: the law is
the same. Letters: E environments.
Source: PX4 Autopilot 1.14, ``src/lib/rate_control`` and the filters of ``src/lib/mathlib``; parameters as in its reference.
"""

from dataclasses import dataclass
from math import cos, pi, radians, tan

import torch
from torch import Tensor

FADING_RATE = radians(400.0)
"""Rate error at which the integral grows no more [rad/s]. Source: PX4, ``RateControl::updateIntegral``."""


def rate_torque(
    error: Tensor, wanted: Tensor, ang_acc: Tensor, integral: Tensor, gains: tuple[Tensor, Tensor, Tensor]
) -> Tensor:
    """Return the normalised torque ``P e + I - D w' + FF w_d``, (E, 3).

    Args:
        error: Rate error e [rad/s], body, (E, 3).
        wanted: Wanted rate w_d [rad/s], body, (E, 3).
        ang_acc: Measured angular acceleration w' [rad/s²], body, (E, 3).
        integral: I before this run [-], (E, 3).
        gains: P [s/rad], D [s²/rad] and FF [s/rad], (E, 3) each.
    """
    proportional, derivative, forward = gains
    return proportional * error + integral - derivative * ang_acc + forward * wanted


def grown_integral(integral: Tensor, error: Tensor, short: Tensor, gain: Tensor, limit: Tensor, dt: float) -> Tensor:
    """Return the integral [-], (E, 3), after a run: slower the larger the error, and no further where rotors gave less.

    Args:
        integral: Before the run [-], (E, 3).
        error: Rate error [rad/s], body, (E, 3).
        short: Sign of the torque that the rotors did not give in the run before, (E, 3); 0 where they gave all.
        gain: I [1/rad], (E, 3).
        limit: [-], (E, 3).
        dt: Between runs [s].
    """
    useful = torch.where(short * error > 0.0, 0.0, error)
    fading = (1.0 - (useful / FADING_RATE).square()).clamp_min(0.0)
    grown = integral + fading * gain * useful * dt
    return torch.minimum(torch.maximum(grown, -limit), limit)


@dataclass(frozen=True)
class LowPass2:
    """Coefficients of a second-order Butterworth low-pass, run in direct form II."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


def butterworth(cutoff_hz: float, rate_hz: float) -> LowPass2 | None:
    """Return the low-pass of a cut-off at a sampling rate; None for a cut-off of 0.

    Source: bilinear transform of ``1 / (s² + sqrt 2 s + 1)``, e.g. Oppenheim, Schafer (2010), Discrete-Time Signal Processing,
    7.3; PX4, ``LowPassFilter2p``.
    """
    if cutoff_hz == 0.0:
        return None
    warped = tan(pi * cutoff_hz / rate_hz)
    scale = 1.0 + 2.0 * cos(0.25 * pi) * warped + warped**2
    b0 = warped**2 / scale
    return LowPass2(
        b0, 2.0 * b0, b0, 2.0 * (warped**2 - 1.0) / scale, (1.0 - 2.0 * cos(0.25 * pi) * warped + warped**2) / scale
    )


def low_passed(sample: Tensor, kept: Tensor, begins: Tensor, filter: LowPass2) -> tuple[Tensor, Tensor]:
    """Return the filtered sample (E, 3) and what is kept of it, (E, 6); a filter that begins is at rest at its sample.

    Args:
        sample: (E, 3).
        kept: The last two inner values, (E, 6).
        begins: Whether there has been no sample yet, bool (E, 1).
        filter: Coefficients.
    """
    resting = sample / (1.0 + filter.a1 + filter.a2)
    first, second = (torch.where(begins, resting, part) for part in kept.split(3, dim=-1))
    inner = sample - filter.a1 * first - filter.a2 * second
    return filter.b0 * inner + filter.b1 * first + filter.b2 * second, torch.cat((inner, first), dim=-1)


def smoothing(cutoff_hz: float, dt: float) -> float:
    """Return the share of the new value that a first-order low-pass takes in: ``dt / (dt + 1 / (2 pi f))``; 1 without one.

    Source: PX4, ``AlphaFilter``; the backward Euler step of ``tau y' = x - y``.
    """
    return 1.0 if cutoff_hz == 0.0 else dt / (dt + 1.0 / (2.0 * pi * cutoff_hz))
