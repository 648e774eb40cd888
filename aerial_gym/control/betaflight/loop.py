"""Rates, integral and mixer of Betaflight: pure functions of tensors.

A correction of 1 is the whole range of the motors, from their lowest to their highest speed.
Letters: E environments, R rotors.
Source: as in ``config.autopilots.betaflight``.
"""

from math import radians

import torch
from torch import Tensor

RELAXED_FROM = radians(40.0)
"""High-passed setpoint at which I-term relax stops the integral [rad/s]. Source: Betaflight 4.5, ``pid.c``, 40 deg/s."""

RATE_LIMIT = radians(1998.0)
"""Largest rate setpoint of the sticks [rad/s]. Source: Betaflight 4.5, ``rc.c``, 1998 deg/s."""

THROTTLE_STEP = 0.001
"""Resolution of the throttle command [-]; a smaller throttle is zero. Source: Betaflight 4.5, ``rc.c``, 1000 to 2000 us."""


def actual_rate(stick: Tensor, center: Tensor, largest: Tensor, expo: Tensor) -> Tensor:
    """Return the rate setpoint of a stick: ``c x + max(m - c, 0) |x| (e x⁵ + (1 - e) x)``, at most ``RATE_LIMIT``.

    Args:
        stick: x, -1 to 1, (E, 3).
        center: c, rate per stick about the centre [rad/s], (E, 3).
        largest: m, rate at full stick [rad/s], (E, 3).
        expo: e, 0 to 1, (E, 3).

    Source:
        Betaflight 4.5, Actual rates: ``rc.c``, ``applyActualRates``.
    """
    bent = stick.abs() * (expo * stick**5 + (1.0 - expo) * stick)
    return (center * stick + (largest - center).clamp_min(0.0) * bent).clamp(-RATE_LIMIT, RATE_LIMIT)


def anti_windup_factor(change: Tensor, used: Tensor, windup: float) -> Tensor:
    """Return the anti-windup factor on the growth of the integrals, (E, 3), 0 to 1.

    Args:
        change: Setpoint minus its low-pass [rad/s], (E, 3); 0 on axes without I-term relax.
        used: Range of the previous corrections, as a share of the motors' range, (E, 1).
        windup: Range from which the integral of yaw slows down; 1 for never.

    Source:
        Betaflight 4.3 to 4.5, ``pid.c``: I-term relax by the setpoint; ``iterm_windup`` acts on yaw alone (pull request 9597).
    """
    rest = (1.0 - change.abs() / RELAXED_FROM).clamp_min(0.0)
    if windup >= 1.0:
        return rest
    room = ((1.0 - used) / (1.0 - windup)).clamp(0.0, 1.0)
    return torch.cat((rest[:, :2], rest[:, 2:] * room), dim=-1)


def mix_signals(throttle: Tensor, mix: Tensor, *, airmode: bool) -> tuple[Tensor, Tensor]:
    """Return motor signals, 0 to 1, (E, R), and the range of the corrections, (E, 1).

    Corrections that need more than the motors' range are scaled down to it. Without airmode they are scaled further:
    by a half at zero throttle, linearly less up to half throttle. The throttle then moves until no motor exceeds a limit.

    Args:
        throttle: Signals without corrections, (E, R); their mean is the throttle.
        mix: Corrections, (E, R).
        airmode: Whether corrections keep their size at low throttle.

    Source:
        Betaflight 4.3 to 4.5, mixer type LEGACY: ``mixer.c``, ``applyMixerAdjustment``.
    """
    used = mix.amax(-1, keepdim=True).clamp_min(0.0) - mix.amin(-1, keepdim=True).clamp_max(0.0)
    scaled = mix / used.clamp_min(1.0)
    if not airmode:
        scaled = scaled * (0.5 + throttle.mean(-1, keepdim=True)).clamp(0.5, 1.0)
    signal = throttle + scaled
    signal = signal + (-signal.amin(-1, keepdim=True)).clamp_min(0.0)
    signal = signal - (signal.amax(-1, keepdim=True) - 1.0).clamp_min(0.0)
    return signal.clamp(0.0, 1.0), used


def throttle_attenuation(throttle: Tensor, rate: float, breakpoint: float) -> Tensor:
    """Return the factor of throttle PID attenuation, (E, 1), at signals without corrections, (E, R).

    Args:
        throttle: 0 to 1, (E, R); their mean counts.
        rate: Attenuation at full throttle, 0 to 1.
        breakpoint: Throttle at which attenuation begins, 0 to below 1.
    """
    return 1.0 - rate * ((throttle.mean(-1, keepdim=True) - breakpoint) / (1.0 - breakpoint)).clamp(0.0, 1.0)
