"""Rates, integral and mixer of Betaflight: pure functions of tensors.

A correction of 1 is the whole range of the motors, from their lowest to their highest speed.
Letters: E environments, R rotors.
Source: as in ``config.autopilots.betaflight``.
"""

from math import radians

import torch
from torch import Tensor

RELAXED_FROM = radians(40.0)
"""Change of the wanted rate at which the integral rests [rad/s]. That it rests then is documented; the 40 deg/s are not."""


def actual_rate(stick: Tensor, center: Tensor, largest: Tensor, expo: Tensor) -> Tensor:
    """Return the rate that a stick asks for: ``c x + max(m - c, 0) |x| (e x⁵ + (1 - e) x)``.

    Args:
        stick: x, -1 to 1, (E, 3).
        center: c, rate per stick about the centre, (E, 3).
        largest: m, rate at full stick, in the unit of ``center``, (E, 3).
        expo: e, 0 to 1, (E, 3).

    Source:
        Betaflight's Actual rates: slope at the centre, rate at full stick, and a bend between that leaves both. The fifth power
        is not in its documentation and was not checked against the firmware.
    """
    bent = stick.abs() * (expo * stick**5 + (1.0 - expo) * stick)
    return center * stick + (largest - center).clamp_min(0.0) * bent


def integral_share(change: Tensor, used: Tensor, windup: float) -> Tensor:
    """Return at which share of its speed an integral grows, (E, 3), 0 to 1.

    Args:
        change: How far the wanted rate is from its low-pass [rad/s], (E, 3); 0 where the integral is not relaxed.
        used: Share of the motors' range that the corrections of the run before used, (E, 1).
        windup: Share from which it slows down; 1 for never.
    """
    rest = (1.0 - change.abs() / RELAXED_FROM).clamp_min(0.0)
    if windup >= 1.0:
        return rest
    return rest * ((1.0 - used) / (1.0 - windup)).clamp(0.0, 1.0)


def mixed(throttle: Tensor, mix: Tensor, *, airmode: bool) -> tuple[Tensor, Tensor]:
    """Return motor signals, 0 to 1, (E, R), and the share of the range that the corrections use, (E, 1).

    Corrections that need more than the range are made smaller, all alike, and then fill it. Else, at full throttle it gives
    way to them, and with airmode also at low throttle: the differences between the motors stay.

    Args:
        throttle: Signals without corrections, (E, R).
        mix: Corrections, (E, R).
        airmode: Whether low throttle rises.

    Source:
        Betaflight's guides on airmode and mixer types (LEGACY), which tell in words what is kept when motors saturate.
    """
    lowest, highest = mix.amin(-1, keepdim=True), mix.amax(-1, keepdim=True)
    used = highest - lowest
    filling = (mix - lowest) / used.clamp_min(1.0)
    signal = throttle + mix
    if airmode:
        signal = signal + (-signal.amin(-1, keepdim=True)).clamp_min(0.0)
    signal = signal - (signal.amax(-1, keepdim=True) - 1.0).clamp_min(0.0)
    return torch.where(used > 1.0, filling, signal).clamp(0.0, 1.0), used


def weakening(throttle: Tensor, rate: float, breakpoint: float) -> Tensor:
    """Return the factor of throttle PID attenuation, (E, 1), at signals without corrections, (E, R).

    Args:
        throttle: 0 to 1, (E, R); their mean counts.
        rate: By how much at full throttle, 0 to 1.
        breakpoint: Throttle from which it begins, 0 to below 1.
    """
    return 1.0 - rate * ((throttle.mean(-1, keepdim=True) - breakpoint) / (1.0 - breakpoint)).clamp(0.0, 1.0)
