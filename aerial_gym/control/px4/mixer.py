"""PX4's mixer: from normalised torque and thrust to motor signals, and what gives way where motors are at their limits.

Commands give way one after the other along their columns of the mixing matrix, thrust, roll, pitch, yaw: never thrust upwards
for roll and pitch with airmode 0, for roll and pitch with 1, for yaw as well with 2. What a column takes off a command says
exactly how much of that command is not given.
Frames: body is x forward, y left, z up; PX4's y and z turn two columns and their commands alike: the order is the same.
Letters: E environments, R rotors.

Source: PX4 Autopilot 1.14, ``ControlAllocationSequentialDesaturation``.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from aerial_gym.physics.fused.allocation import NEGLIGIBLE

ROLL, PITCH, YAW, THRUST = range(4)
"""Columns of the mixing matrix."""

WEAK = 0.2
"""Part of a motor in a command, normalised, below which that motor is not asked to make room by it."""

YAW_MARGIN = 0.15
"""Share of the range of a motor beyond its upper limit up to which yaw is kept, and thrust given for it."""


class Mixed(NamedTuple):
    """Motor signals, and what they do not give."""

    signal: Tensor
    """Share of the full thrust, (E, R)."""

    short: Tensor
    """Sign of the torque about each axis that is not given, (E, 3); 0 where all is."""


def mix(columns: Tensor, wanted: Tensor, low: Tensor, *, airmode: int) -> Mixed:
    """Return what PX4 tells the motors.

    Where even that leaves a motor beyond a limit it is cut off, and no torque counts as given.

    Args:
        columns: Mixing matrix, normalised as ``parameters.unit_wrench``, (E, R, 4).
        wanted: Normalised roll, pitch and yaw torque and thrust, (E, 4).
        low: Lowest signals, (E, R); the highest are 1.
        airmode: MC_AIRMODE: 0, 1 or 2.
    """
    given, high = wanted.clone(), torch.ones_like(low)

    def make_room(signal: Tensor, axis: int, top: Tensor, *, only_less: bool = False) -> Tensor:
        column = columns[..., axis]
        first = _room(signal, column, low, top)
        if only_less:
            first = torch.where(first > 0.0, 0.0, first)
        moved = signal + first * column
        second = 0.5 * _room(moved, column, low, top)
        if only_less:
            second = torch.where(first == 0.0, 0.0, second)
        given[:, axis : axis + 1] += first + second
        return moved + second * column

    yaw, first = columns[..., YAW] * wanted[:, YAW : YAW + 1], [ROLL, PITCH, THRUST]
    signal = (columns[..., first] * wanted[:, None, first]).sum(-1)
    if airmode == 2:
        signal = make_room(make_room(signal + yaw, THRUST, high), YAW, high)
    else:
        signal = make_room(signal, THRUST, high, only_less=airmode == 0)
        if airmode == 0:
            signal = make_room(make_room(signal, ROLL, high), PITCH, high)
        signal = make_room(signal + yaw, YAW, high + YAW_MARGIN * (high - low))
        signal = make_room(signal, THRUST, high, only_less=True)
    cut = torch.minimum(torch.maximum(signal, low), high)
    within = ((cut - signal).abs() <= NEGLIGIBLE).all(-1, keepdim=True)
    lost = torch.where(within, wanted - given, wanted)[:, :3]
    return Mixed(cut, torch.where(lost.abs() > NEGLIGIBLE, lost.sign(), 0.0))


def _room(signal: Tensor, column: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return how far to go along a column, (E, 1), that what is beyond the limits on either side is so no more or as little."""
    beyond = torch.minimum(torch.maximum(signal, low), high) - signal
    strong = column.abs() >= WEAK
    steps = torch.where(strong, beyond / torch.where(strong, column, 1.0), 0.0)
    return steps.amin(-1, keepdim=True).clamp_max(0.0) + steps.amax(-1, keepdim=True).clamp_min(0.0)
