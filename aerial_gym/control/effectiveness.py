"""The control effectiveness matrix, from rotor thrusts to the wrench on the body, and its inverses.

Frames: body is x forward, y left, z up. Letters: E environments, R rotors, N independent forces and torques.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import torch
from torch import Tensor

from aerial_gym.physics.fused.allocation import NEGLIGIBLE
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, state_for_thrust
from aerial_gym.physics.vehicle import Vehicle

PRIORITY = (3, 4, 2, 5, 0, 1)  # Rows of the matrix by priority: roll and pitch torque, thrust, yaw torque, force x, y

OF_ITS_OWN = 0.1
"""Least orthogonal share of a row that counts as a further independent axis. Any value below ``1 / sqrt(6)`` finds as many as
the rank: one of the six unit vectors has that share in an uncovered direction."""

DEPENDENT = 1e-5  # Orthogonal share below which a row is dependent; float32 rounding leaves some 1e-6 to be amplified


def allocation_matrix(vehicle: Vehicle, gravity: float) -> Tensor:
    """Return the matrix that maps rotor thrusts to force and torque about the centre of mass, (E, 6, R).

    A column is ``[a; (r - c) x a - s k a]`` with axis a, hub r, centre of mass c, spin s and torque per thrust k. If the two
    polynomials are not proportional, k is that of the hover thrust ``m g / R``, or of the largest thrust without weight.

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
    """Return the pseudo-inverse (..., R, 6), with round-off set to 0."""
    return _without_round_off(torch.linalg.pinv(matrix), matrix)


def _without_round_off(inverse: Tensor, matrix: Tensor) -> Tensor:
    """Set entries of an inverse (..., R, 6) that are round-off to exactly 0."""
    part = inverse.detach().abs() * matrix.detach().abs().amax(-1).unsqueeze(-2)
    return torch.where(part > NEGLIGIBLE, inverse, 0.0)


@dataclass(frozen=True)
class CommandAxes:
    """Commanded forces and torques: as many as the rotors give independently, by ``PRIORITY``.

    Side effects are accepted: the lateral force of tilted rotors, the yaw torque of rotors with equal spin.
    """

    axes: tuple[int, ...]  # Rows of the effectiveness matrix, N of them, in the order of `PRIORITY`
    lengths: tuple[float, ...]  # Of these rows

    def mask_rows(self, matrix: Tensor) -> Tensor:
        """Return an effectiveness matrix (..., 6, R) with zeros in uncommanded rows."""
        kept = torch.zeros(6, 1, dtype=torch.bool, device=matrix.device)
        kept[list(self.axes)] = True
        return torch.where(kept, matrix, 0.0)


def find_actuation(matrix: Tensor) -> CommandAxes:
    """Find the independent forces and torques of one vehicle from its effectiveness matrix (6, R).

    An axis counts if enough of it, in the range of the matrix, is orthogonal to the axes of higher priority. The CPU computes
    this: a GPU loads its library of linear algebra at the first decomposition, which takes 0.5 s.
    """
    exact = matrix.detach().double().cpu()
    left, size, _ = torch.linalg.svd(exact, full_matrices=False)
    span = left[:, size > max(exact.shape) * torch.finfo(torch.float32).eps * size[0]]  # as in torch.linalg.pinv
    directions, axes = exact.new_zeros(0, span.shape[1]), []
    for axis in PRIORITY:
        rest = span[axis] - directions.T @ (directions @ span[axis])
        if rest.norm() > OF_ITS_OWN:
            directions = torch.cat((directions, (rest / rest.norm()).unsqueeze(0)))
            axes.append(axis)
    return CommandAxes(tuple(axes), tuple(exact[axes].norm(dim=-1).tolist()))


def right_inverse(matrix: Tensor, actuation: CommandAxes) -> Tensor:
    """Return the least-norm thrusts per commanded force and torque, (E, R, 6), without round-off.

    It is the pseudo-inverse of the commanded rows A of the effectiveness matrix, ``A^+ = A^T (A A^T)^-1``, with zeros for the
    others, so that commands are met exactly. A row that depends on those before it gets zeros.

    The arithmetic is differentiable and can be traced into a kernel: modified Gram-Schmidt gives ``A = L Q``, hence
    ``A^+ = Q^T L^-1``.

    Args:
        matrix: Control effectiveness of each environment, (E, 6, R).
        actuation: Commanded forces and torques of the nominal vehicle.

    Source:
        Golub, Van Loan (2013), Matrix Computations, 5.2.8 and 5.6: QR of A^T for the least-norm solution.
    """
    directions: list[Tensor] = []
    solved: list[list[Tensor]] = []  # rows of L^-1, (E, 1) each
    for axis, nominal in zip(actuation.axes, actuation.lengths, strict=True):
        row = matrix[:, axis]
        rest, shares = row, []
        for direction in directions:
            shares.append((rest * direction).sum(-1, keepdim=True))
            rest = rest - shares[-1] * direction
        left, whole = (each.square().sum(-1, keepdim=True) for each in (rest, row))
        kept = left > DEPENDENT**2 * whole.clamp_min(nominal**2)
        size = torch.where(kept, left, 1.0).sqrt()
        count = len(directions)
        before = [_sum_of_terms(shares[i] * solved[i][k] for i in range(k, count)) for k in range(count)]
        unit = torch.ones_like(size)
        solved.append([torch.where(kept, each / size, 0.0) for each in (*(-each for each in before), unit)])
        directions.append(torch.where(kept, rest / size, 0.0))
    count = len(directions)
    columns = dict.fromkeys(range(6), torch.zeros_like(matrix[:, 0]))
    for k, axis in enumerate(actuation.axes):
        columns[axis] = _sum_of_terms(solved[j][k] * directions[j] for j in range(k, count))
    return _without_round_off(torch.stack([columns[axis] for axis in range(6)], dim=-1), matrix)


def _sum_of_terms(terms: Iterable[Tensor]) -> Tensor:
    return reduce(torch.add, terms)
