"""The control effectiveness matrix, from rotor thrusts to the wrench on the body, and its inverses.

Frames: body is x forward, y left, z up. Letters: E environments, R rotors, N independent forces and torques.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import torch
from torch import Tensor

from aerial_gym.physics.fused.allocation import NEGLIGIBLE
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, state_for_thrust
from aerial_gym.physics.vehicle import Vehicle

PRIORITY = (3, 4, 2, 5, 0, 1)
"""Rows of the matrix by what matters most: torque of roll and pitch, thrust, torque of yaw, force forwards and to the left."""

OF_ITS_OWN = 0.1
"""Share of a row, orthogonal to those before it, from which on it is taken as one more. Any below ``1 / sqrt(6)`` finds as many
as the rank: of a row space that is not covered yet, some of the six unit vectors has that share."""

DEPENDENT = 1e-5
"""Share of the length of a row, orthogonal to those before it, below which nothing is asked of it: round-off of float32 leaves
some 1e-6 of a row that depends on others, and an inverse would make a command of it."""


def allocation_matrix(vehicle: Vehicle, gravity: float) -> Tensor:
    """Return the matrix that maps rotor thrusts to force and torque about the centre of mass, (E, 6, R).

    A column is ``[a; (r - c) x a - s k a]`` with axis a, hub r, centre of mass c, spin s and torque per thrust k, taken
    at the hover thrust ``m g / R`` where the two polynomials are not proportional, and at the largest one without weight.

    Source:
        Mahony, Kumar, Corke (2012), Multirotor Aerial Vehicles, eq. 8, for arbitrary axes.
    """
    hover = (vehicle.mass * gravity / vehicle.num_rotors).unsqueeze(-1).expand(-1, vehicle.num_rotors)
    state = state_for_thrust(vehicle, torch.where(hover > 0.0, hover, rotor_thrust(vehicle, vehicle.speed_high)))
    torque_ratio = rotor_torque(vehicle, state) / rotor_thrust(vehicle, state)
    lever = vehicle.rotor_position - vehicle.com.unsqueeze(1)
    reaction = (vehicle.rotor_spin * torque_ratio).unsqueeze(-1) * vehicle.rotor_axis
    torque = torch.linalg.cross(lever, vehicle.rotor_axis) - reaction
    return torch.cat((vehicle.rotor_axis, torque), dim=-1).transpose(1, 2)


def pseudo_inverse(matrix: Tensor) -> Tensor:
    """Return the pseudo-inverse (..., R, 6) without its round-off."""
    return _without_round_off(torch.linalg.pinv(matrix), matrix)


def _without_round_off(inverse: Tensor, matrix: Tensor) -> Tensor:
    """Return an inverse (..., R, 6) in which a rotor that has no part in something is told so exactly."""
    part = inverse.detach().abs() * matrix.detach().abs().amax(-1).unsqueeze(-2)
    return torch.where(part > NEGLIGIBLE, inverse, 0.0)


@dataclass(frozen=True)
class Actuation:
    """The forces and torques that rotors can give independently of each other; the rest of a wrench is not asked of them.

    With the rotors of a flat multirotor these are roll, pitch, thrust and yaw; with tilted ones they may be combinations.
    """

    rows: tuple[tuple[float, ...], ...]
    """From a wrench to these, (N, 6), in the order of ``PRIORITY``."""

    lengths: tuple[float, ...]
    """Of these rows of the effectiveness matrix."""


def actuation_of(matrix: Tensor) -> Actuation:
    """Return what the rotors of one vehicle can give, from its effectiveness matrix (6, R): the range of the matrix.

    The rows are those of the projection on that range, so that of the same matrix ``right_inverse`` is the pseudo-inverse.
    """
    exact = matrix.detach().double()
    left, size, _ = torch.linalg.svd(exact, full_matrices=False)
    span = left[:, size > max(exact.shape) * torch.finfo(torch.float32).eps * size[0]]  # as torch.linalg.pinv has it
    projection = torch.round(span @ span.T, decimals=12)
    directions, rows = exact.new_zeros(0, 6), []
    for axis in PRIORITY:
        rest = projection[axis] - directions.T @ (directions @ projection[axis])
        if rest.norm() > OF_ITS_OWN:
            directions = torch.cat((directions, (rest / rest.norm()).unsqueeze(0)))
            rows.append(projection[axis])
    chosen = torch.stack(rows)
    return Actuation(tuple(map(tuple, chosen.tolist())), tuple((chosen @ exact).norm(dim=-1).tolist()))


def right_inverse(matrix: Tensor, actuation: Actuation) -> Tensor:
    """Return the least thrusts for each force and torque that ``actuation`` knows, (E, R, 6), without round-off.

    It is the pseudo-inverse of these rows C of the effectiveness matrix B, ``A^+ = A^T (A A^T)^-1`` with ``A = C B``, times C.
    What rotors that stand or point elsewhere give besides, lateral force of a tilted one, is let happen: what is asked for is
    given exactly. Where a row depends on those before it, nothing is asked of it.

    Plain arithmetic on rows: differentiable, and traced into a kernel. Rows are made orthogonal one after the other (modified
    Gram-Schmidt), ``A = L Q``, so that ``A^+ = Q^T L^-1``.

    Args:
        matrix: Control effectiveness of each environment, (E, 6, R).
        actuation: What the rotors of the nominal vehicle can give.

    Source:
        Golub, Van Loan (2013), Matrix Computations, 5.2.8 and 5.6: QR of A^T for the least-norm solution.
    """
    directions: list[Tensor] = []
    solved: list[list[Tensor]] = []  # rows of L^-1, (E, 1) each
    for weights, nominal in zip(actuation.rows, actuation.lengths, strict=True):
        row = _weighted([matrix[:, axis] for axis in range(6)], weights)
        rest, shares = row, []
        for direction in directions:
            shares.append((rest * direction).sum(-1, keepdim=True))
            rest = rest - shares[-1] * direction
        left, whole = (each.square().sum(-1, keepdim=True) for each in (rest, row))
        kept = left > DEPENDENT**2 * whole.clamp_min(nominal**2)
        size = torch.where(kept, left, 1.0).sqrt()
        count = len(directions)
        before = [_total(shares[i] * solved[i][k] for i in range(k, count)) for k in range(count)]
        unit = torch.ones_like(size)
        solved.append([torch.where(kept, each / size, 0.0) for each in (*(-each for each in before), unit)])
        directions.append(torch.where(kept, rest / size, 0.0))
    count = len(directions)
    columns = [_total(solved[j][k] * directions[j] for j in range(k, count)) for k in range(count)]
    inverse = [_weighted(columns, [row[axis] for row in actuation.rows]) for axis in range(6)]
    return _without_round_off(torch.stack(inverse, dim=-1), matrix)


def _total(terms: Iterable[Tensor]) -> Tensor:
    return reduce(torch.add, terms)


def _weighted(tensors: Sequence[Tensor], weights: Sequence[float]) -> Tensor:
    """Return the weighted sum without the terms that are zero: a kernel is traced from it."""
    terms = [
        tensor if weight == 1.0 else weight * tensor for tensor, weight in zip(tensors, weights, strict=True) if weight
    ]
    return _total(terms) if terms else torch.zeros_like(tensors[0])
