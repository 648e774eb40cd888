"""Dynamics of a tree of links: ``M a + h = f``, in the coordinates of its motion.

Derived by virtual power: every link obeys Newton's and Euler's laws, and constraint forces of joints do no work.
Pure functions of tensors, any float type, differentiable; no loop over environments.
Letters: E environments, D joints, L = D + 1 links, N = 6 + D.

Sources:
    Kane, Levinson (1985), Dynamics: Theory and Applications, section 6.1;
    Featherstone (2008), Rigid Body Dynamics Algorithms, sections 6.1 and 6.2 (mass matrix; factor of a positive definite one).
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.motion import (
    LinkMotion,
    LinkPoses,
    angular_jacobian,
    cross,
    move_links,
    place_links,
    point_jacobian,
)
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState


@dataclass(frozen=True, kw_only=True)
class EquationsOfMotion:
    """``mass a = force`` for the accelerations ``a`` of the coordinates of motion."""

    mass: Tensor  # M, symmetric and positive definite, (E, N, N)
    force: Tensor  # Applied forces minus velocity terms, (E, N): force [N], torque [N m], efforts of joints
    places: LinkPoses
    motion: LinkMotion


@dataclass(frozen=True, kw_only=True)
class TreeAccelerations:
    """Accelerations of a tree."""

    lin_acc: Tensor  # Acceleration of the base's origin [m/s²], world, (E, 3)
    ang_acc: Tensor  # Angular acceleration of the base [rad/s²], base axes, (E, 3)
    joint_acc: Tensor  # Accelerations of the joints [rad/s²] or [m/s²], (E, D)


def equations_of_motion(
    tree: Tree, links: Links, state: TreeState, *, gravity: float, wrench: Tensor | None = None,
    effort: Tensor | None = None,
) -> EquationsOfMotion:  # fmt: skip
    """Return the equations of motion.

    Args:
        wrench: Force [N] on each link at its origin and torque [N m], axes of the link, (E, L, 6); none if not given.
        effort: Of each joint [N m] or [N], (E, D); none if not given.
    """
    places = place_links(tree, links, state.joint_pos)
    lin_vel = quat_rotate_inverse(state.attitude, state.lin_vel)
    motion = move_links(tree, places, lin_vel, state.ang_vel, state.joint_vel)
    turns, moves = angular_jacobian(tree, places), point_jacobian(tree, places, places.com)
    mass = links.mass.expand(len(moves), -1).unsqueeze(-1)
    matrix = sum_of_products(moves, moves * mass.unsqueeze(-1))
    matrix = matrix + sum_of_products(turns, places.inertia @ turns)
    down = quat_rotate_inverse(state.attitude, state.lin_vel.new_tensor((0.0, 0.0, -gravity)).expand_as(state.lin_vel))
    momentum = (places.inertia @ motion.ang_vel.unsqueeze(-1)).squeeze(-1)
    bend = (places.inertia @ motion.ang_acc.unsqueeze(-1)).squeeze(-1) + cross(motion.ang_vel, momentum)
    force = forces_along_coordinates(moves, mass * (down.unsqueeze(1) - motion.com_acc))
    force = force - forces_along_coordinates(turns, bend)
    if wrench is not None:
        push, twist = (
            (places.rotation @ part.unsqueeze(-1)).squeeze(-1) for part in (wrench[..., :3], wrench[..., 3:])
        )
        force = force + forces_along_coordinates(point_jacobian(tree, places, places.origin), push)
        force = force + forces_along_coordinates(turns, twist)
    if effort is not None:
        force = torch.cat((force[:, :6], force[:, 6:] + effort), dim=-1)
    return EquationsOfMotion(mass=matrix, force=force, places=places, motion=motion)


def forces_along_coordinates(rates: Tensor, vectors: Tensor) -> Tensor:
    """Return the generalised forces (E, N) of link vectors (E, L, 3), by their Jacobian (E, L, 3, N).

    Matrix products of each environment, because ``einsum`` changes the order of sums for a single one.
    """
    return torch.bmm(vectors.flatten(1).unsqueeze(1), rates.flatten(1, 2)).squeeze(1)


def sum_of_products(one: Tensor, other: Tensor) -> Tensor:
    """Return ``sum one^T other`` over the links, (E, N, N), of (E, L, 3, N) each, likewise."""
    return torch.bmm(one.flatten(1, 2).transpose(1, 2), other.flatten(1, 2))


def add_at_centers(tree: Tree, system: EquationsOfMotion, mass: Tensor, wrench: Tensor) -> EquationsOfMotion:
    """Return the equations of motion with further masses and constant wrenches at the centres of mass of links.

    Args:
        mass: Masses along [kg] and inertias about [kg m²] the axes of each link, (E, L, 6).
        wrench: Force [N] and torque [N m], axes of the link, (E, L, 6).
    """
    places, matrix, force = system.places, system.mass, system.force
    jacobians = point_jacobian(tree, places, places.com), angular_jacobian(tree, places)
    for jacobian, own, push in zip(jacobians, mass.split(3, dim=-1), wrench.split(3, dim=-1), strict=True):
        rates = places.rotation.mT @ jacobian  # (E, L, 3, N), axes of the link
        matrix = matrix + sum_of_products(rates, own.unsqueeze(-1) * rates)
        force = force + forces_along_coordinates(rates, push)
    return replace(system, mass=matrix, force=force)


def velocity_rates_of_centers(system: EquationsOfMotion, turned_wind: Tensor) -> Tensor:
    """Return the rates of ``(u, w)`` in axes of each link at zero acceleration of all coordinates, (E, L, 6).

    Here u is the velocity of the centre of mass through the air, and w the angular velocity: ``u' = a - w x v + w x wind``.

    Args:
        turned_wind: ``w x wind`` [m/s²], axes of the link, (E, L, 3).
    """
    places, motion = system.places, system.motion
    com_vel = motion.lin_vel + cross(motion.ang_vel, places.com - places.origin)
    swing = places.to_link(motion.com_acc - cross(motion.ang_vel, com_vel)) + turned_wind
    return torch.cat((swing, places.to_link(motion.ang_acc)), dim=-1)


def solve(tree: Tree, state: TreeState, mass: Tensor, force: Tensor) -> TreeAccelerations:
    """Solve ``mass`` (E, N, N) times accelerations = ``force`` (E, N); a fixed base has none.

    A motion that is not finite gives accelerations that are not finite, without an exception or a wait.
    """
    first = 0 if tree.floating else 6
    root = torch.linalg.cholesky_ex(mass[:, first:, first:]).L
    solution = torch.cholesky_solve(force[:, first:].unsqueeze(-1), root).squeeze(-1)
    solution = torch.cat((solution.new_zeros(len(solution), first), solution), dim=-1)
    return TreeAccelerations(
        lin_acc=quat_rotate(state.attitude, solution[:, :3]), ang_acc=solution[:, 3:6], joint_acc=solution[:, 6:]
    )


def accelerations(
    tree: Tree, links: Links, state: TreeState, *, gravity: float, wrench: Tensor | None = None,
    effort: Tensor | None = None,
) -> TreeAccelerations:  # fmt: skip
    """Return the accelerations of a tree; arguments as for ``equations_of_motion``."""
    system = equations_of_motion(tree, links, state, gravity=gravity, wrench=wrench, effort=effort)
    return solve(tree, state, system.mass, system.force)
