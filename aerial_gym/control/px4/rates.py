"""PX4's rate controller: pure functions of tensors. Its filters of second order are in ``control.filters``.

Frames: body is x forward, y left, z up. PX4's y right and z down change signs but not the law. Letters: E environments.
Source: PX4 Autopilot 1.14, ``src/lib/rate_control`` and the filters of ``src/lib/mathlib``; parameters as in its reference.
"""

from math import pi, radians

import torch
from torch import Tensor

RATE_NUMBERS = 19
"""Memory of the rate controller: integral (3), angular acceleration (3), previous body rates (3), state of the low-pass of
body rates (6), unallocated torque (3), yaw torque (1); then six numbers of each notch."""

FADING_RATE = radians(400.0)
"""Rate error at which the integral stops [rad/s]. Source: PX4, ``RateControl::updateIntegral``."""


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


def update_integral(integral: Tensor, error: Tensor, short: Tensor, gain: Tensor, limit: Tensor, dt: float) -> Tensor:
    """Return the integral [-], (E, 3), after a run: it slows with the error and stops for unallocated torque.

    Args:
        integral: Integral before the run [-], (E, 3).
        error: Rate error [rad/s], body, (E, 3).
        short: Sign of the unallocated torque in the previous run, (E, 3); 0 if all was allocated.
        gain: I [1/rad], (E, 3).
        limit: [-], (E, 3).
        dt: Period of the runs [s].
    """
    useful = torch.where(short * error > 0.0, 0.0, error)
    fading = (1.0 - (useful / FADING_RATE).square()).clamp_min(0.0)
    return (integral + fading * gain * useful * dt).clamp(-limit, limit)


def smoothing_coefficient(cutoff_hz: float, dt: float) -> float:
    """Return the coefficient of a first-order low-pass, the share of the new value: ``dt / (dt + 1 / (2 pi f))``; 1 for f = 0.

    Source: PX4, ``AlphaFilter``; the backward Euler step of ``tau y' = x - y``.
    """
    return 1.0 if cutoff_hz == 0.0 else dt / (dt + 1.0 / (2.0 * pi * cutoff_hz))
