"""Affine errors of inertial sensors: offset and matrix of all effects on specific force and angular velocity.

Frames: body is x forward, y left, z up. Letters: E environments, P parameters of an effect.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.physics.effects.kinds.sensor import ImuEffect

WIDTH = 24
"""Numbers of an environment: offset and columns of the matrix, 4 x 3, of the specific force, then of the angular velocity."""


def imu_errors(effects: Sequence[tuple[ImuEffect, Tensor]]) -> Tensor:
    """Return offset b and columns of A of ``measured = A true + b``, (E, 24), for effects in their order.

    Args:
        effects: At least one, with parameters (E, P).

    Returns:
        ``b, A e_x, A e_y, A e_z`` of the specific force [m/s²], then of the angular velocity [rad/s], body.

    Source:
        Derived: b is the measurement of zero, and a column of A is the measurement of a unit vector minus b.
    """
    first = effects[0][1]
    zero = torch.zeros_like(first[:, :1])
    one = zero + 1.0
    force, ang_vel = [], []
    for axis in (None, 0, 1, 2):
        true = torch.cat([one if k == axis else zero for k in range(3)], dim=1)
        measured = (true, true)
        for effect, params in effects:
            measured = effect.measure(*measured, params)
        force.append(measured[0])
        ang_vel.append(measured[1])
    return torch.cat([rows for outputs in (force, ang_vel) for rows in _subtract_offset(outputs)], dim=1)


def _subtract_offset(outputs: list[Tensor]) -> list[Tensor]:
    return [outputs[0], *(rows - outputs[0] for rows in outputs[1:])]
