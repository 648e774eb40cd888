"""PX4's mixer: from normalised torque and thrust to motor signals, with sequential desaturation.

Commands are reduced one after the other along their columns of the mixing matrix: thrust, roll, pitch, yaw. Thrust may rise
to keep roll and pitch with airmode 1, also to keep yaw with airmode 2, and never with airmode 0. The reduction along a column
is exactly the unallocated part of its command.
Frames: body is x forward, y left, z up; PX4's opposite y and z flip two columns and their commands alike.
Letters: E environments, R rotors.

Source: PX4 Autopilot 1.14, ``ControlAllocationSequentialDesaturation``.
"""

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from aerial_gym.math.rows import compute_if
from aerial_gym.physics.fused.allocation import NEGLIGIBLE

ROLL, PITCH, YAW, THRUST = range(4)  # Columns of the mixing matrix
WEAK = 0.2  # Normalised coefficient of a motor in a command below which the command does not desaturate that motor
YAW_MARGIN = 0.15  # Excess over the upper limit, in motor ranges, up to which yaw is kept and thrust reduced


class MixerOutput(NamedTuple):
    """Motor signals, and the signs of unallocated torque."""

    signal: Tensor  # Share of the full thrust, (E, R)
    short: Tensor  # Sign of the unallocated torque about each axis, (E, 3); 0 if all is allocated


def mix(columns: Tensor, wanted: Tensor, low: Tensor, *, airmode: int) -> MixerOutput:
    """Compute the motor signals of PX4's sequential desaturation.

    A motor that still exceeds a limit is clamped, and then no torque counts as allocated.

    Args:
        columns: Mixing matrix, normalised as ``parameters.unit_wrench``, (E, R, 4).
        wanted: Normalised roll, pitch and yaw torque and thrust, (E, 4).
        low: Lowest signals, (E, R); the highest are 1.
        airmode: MC_AIRMODE: 0, 1 or 2.
    """
    level = (columns * _without_yaw(wanted).unsqueeze(1)).sum(-1)
    plain = level + columns[..., YAW] * wanted[:, YAW : YAW + 1]
    beyond = ((torch.minimum(plain, level) < low) | (torch.maximum(plain, level) > 1.0)).any(-1, keepdim=True)
    return MixerOutput(
        *compute_if(
            beyond, partial(desaturate, airmode), (columns, wanted, low), (plain, torch.zeros_like(wanted[:, :3]))
        )
    )


def _without_yaw(wanted: Tensor) -> Tensor:
    zero = torch.zeros_like(wanted[:, YAW : YAW + 1])
    return torch.cat((wanted[:, :YAW], zero, wanted[:, THRUST:]), dim=-1)


def desaturate(airmode: int, columns: Tensor, wanted: Tensor, low: Tensor) -> tuple[Tensor, Tensor]:
    """Return the fields of ``MixerOutput`` by PX4's sequence of reductions; arguments as for ``mix``."""
    high, parts = torch.ones_like(low), columns.unbind(-1)
    given = list(wanted.split(1, dim=-1))

    def make_room(signal: Tensor, axis: int, top: Tensor, *, only_less: bool = False) -> Tensor:
        first = _desaturation_gain(signal, parts[axis], low, top)
        if only_less:
            first = torch.where(first > 0.0, 0.0, first)
        moved = signal + first * parts[axis]
        second = 0.5 * _desaturation_gain(moved, parts[axis], low, top)
        if only_less:
            second = torch.where(first == 0.0, 0.0, second)
        given[axis] = given[axis] + first + second
        return moved + second * parts[axis]

    yaw = parts[YAW] * wanted[:, YAW : YAW + 1]
    signal = (columns * _without_yaw(wanted).unsqueeze(1)).sum(-1)
    if airmode == 2:
        signal = make_room(make_room(signal + yaw, THRUST, high), YAW, high)
    else:
        signal = make_room(signal, THRUST, high, only_less=airmode == 0)
        if airmode == 0:
            signal = make_room(make_room(signal, ROLL, high), PITCH, high)
        signal = make_room(signal + yaw, YAW, high + YAW_MARGIN * (high - low))
        signal = make_room(signal, THRUST, high, only_less=True)
    cut = signal.clamp(low, high)
    within = ((cut - signal).abs() <= NEGLIGIBLE).all(-1, keepdim=True)
    lost = torch.where(within, wanted - torch.cat(given, dim=-1), wanted)[:, :3]
    return cut, torch.where(lost.abs() > NEGLIGIBLE, lost.sign(), 0.0)


def _desaturation_gain(signal: Tensor, column: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return PX4's desaturation gain (E, 1): the multiple of ``column`` that removes the limit violation, or balances two."""
    beyond = signal.clamp(low, high) - signal
    strong = column.abs() >= WEAK
    steps = torch.where(strong, beyond / torch.where(strong, column, 1.0), 0.0)
    return steps.amin(-1, keepdim=True).clamp_max(0.0) + steps.amax(-1, keepdim=True).clamp_min(0.0)
