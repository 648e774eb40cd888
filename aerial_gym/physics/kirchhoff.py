"""Free motion of a hull with added mass: Kirchhoff's equations by the implicit midpoint rule.

With mass ``M = m + M_A`` along the body axes, v through water in steady uniform motion and no force::

    p' = p x w,    l' = l x w + p x v,    p = M v,    l = J w        body axes

Impulse ``R p``, its moment ``R l + x x R p`` and the energy ``(p . v + l . w) / 2`` are constant. The midpoint rule conserves
quadratic invariants of p and l. With the Cayley rotation of its mean w, and the matching position, it conserves all three.
Source: Lamb (1932), Hydrodynamics, articles 121-124; Hairer, Lubich, Wanner (2006), Geometric Numerical Integration, IV.2.1
(quadratic invariants); Cayley rotation and position: derived. With ``a = dt w / 2`` the rotation is ``(1 - [a])^-1 (1 + [a])``.
"""

import torch
from torch import Tensor

from aerial_gym.math.rows import dot, inverse_3x3
from aerial_gym.physics.rigid_body import multiply_rows

ITERATIONS = 5  # Newton steps for the mean angular velocity. Each squares the error, initially `dt / 2` times w'
cross = torch.linalg.cross


def coast_change(
    mass: Tensor, inertia: Tensor, lin_vel: Tensor, ang_vel: Tensor, dt: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the changes of motion in a step without force; as small numbers they conserve the invariants in float32.

    Args:
        mass: Of hull and water along the body axes [kg], (E, 3).
        inertia: Of hull and water about the centre of mass [kg m²], (E, 3, 3).
        lin_vel: Velocity of the centre of mass through the water [m/s], body, (E, 3).
        ang_vel: Angular velocity [rad/s], body, (E, 3).

    Returns:
        In body axes of the start: the displacement beyond that of the initial velocity [m], (E, 3), and the change of velocity
        [m/s], (E, 3). Then the unnormalised quaternion of the rotation, xyzw, (E, 4), and the final angular velocity [rad/s],
        body axes of the end, (E, 3).
    """
    mean = _mean_ang_vel(mass, inertia, lin_vel, ang_vel, dt)
    a = 0.5 * dt * mean
    square = dot(a, a).unsqueeze(-1)
    more = -cross(a, _half_rotation(a, mass * lin_vel)) / mass  # of the mean velocity, body axes that turn
    end = lin_vel + 2.0 * more
    move = dt / (1.0 + square) * (more + cross(a, lin_vel + more) - square * lin_vel)
    gain = 2.0 * more + 2.0 / (1.0 + square) * (cross(a, end) + cross(a, cross(a, end)))
    return move, gain, torch.cat((a, torch.ones_like(square)), dim=-1), 2.0 * mean - ang_vel


def _mean_ang_vel(mass: Tensor, inertia: Tensor, lin_vel: Tensor, ang_vel: Tensor, dt: float) -> Tensor:
    """Return the mean angular velocity of a step without force [rad/s], body, (E, 3), by Newton's method."""
    half, impulse, spin, mean = 0.5 * dt, mass * lin_vel, multiply_rows(inertia, ang_vel), ang_vel
    unit = torch.eye(3, dtype=mass.dtype, device=mass.device).expand(mass.shape[0], 3, 3)
    for _ in range(ITERATIONS):
        turned, momentum = _half_rotation(half * mean, impulse), multiply_rows(inertia, mean)
        v = turned / mass
        missing = momentum - spin + half * (cross(mean, momentum) + cross(v, turned))
        w, p, v, spun = (rows.unsqueeze(1) for rows in (mean, turned, v, momentum))  # (E, 1, 3)
        more = half * _half_rotation(half * w, cross(p, unit))
        gyroscopic = cross(unit, spun) + cross(w, inertia)
        slopes = inertia + half * (gyroscopic + cross(more / mass.unsqueeze(1), p) + cross(v, more))
        mean = mean - dot(inverse_3x3(slopes.mT), missing.unsqueeze(1))
    return mean


def _half_rotation(a: Tensor, vector: Tensor) -> Tensor:
    """Return ``(1 + [a])^-1 b``, (..., 3): the mean of b and of ``(1 + [a])^-1 (1 - [a]) b``."""
    along = dot(a, vector).unsqueeze(-1) * a
    return (vector - cross(a, vector) + along) / (1.0 + dot(a, a).unsqueeze(-1))
