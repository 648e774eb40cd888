"""Added mass of links in the equations of motion of a tree: ``LinkFluidEffect``.

A link has added masses A and inertias B at its centre of mass. The centre moves at u through fluid in steady uniform motion,
and the link turns at w. In axes of the link, the fluid takes the force ``A u' + w x (A u)`` and the torque
``B w' + w x (B w) + u x (A u)``. The terms in the accelerations add to the mass matrix: ``M + sum J^T (A, B) J``. Added mass
has no weight.
Letters: E environments, L links.

Source: Lamb (1932), Hydrodynamics, articles 121-124 (Kirchhoff's equations).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics.articulated.dynamics import Equations, add_at_centers, center_change
from aerial_gym.physics.articulated.motion import cross
from aerial_gym.physics.articulated.tree import Tree


@dataclass(frozen=True, kw_only=True)
class LinkFluid:
    """Added mass of each link."""

    added: Tensor  # Diagonals of A [kg] and B [kg m²], axes of the link, (E, L, 6)
    wind: Tensor  # Velocity of the fluid [m/s], world, (E, 3)


def fluid_wrench(added: Tensor, velocity: Tensor, change: Tensor) -> Tensor:
    """Return the force and torque of the fluid on links without acceleration, axes of the link, (..., 6).

    Args:
        added: Diagonals of A and B, (..., 6).
        velocity: Of the centre of mass through the fluid, u, and angular velocity, w, (..., 6).
        change: Their rates without acceleration (``dynamics.center_change``), (..., 6).
    """
    (push, twist), (impulse, spin) = ((added * rows).split(3, dim=-1) for rows in (change, velocity))
    through, turn = velocity.split(3, dim=-1)
    force = push + cross(turn, impulse)
    return -torch.cat((force, twist + cross(turn, spin) + cross(through, impulse)), dim=-1)


def add_fluid(tree: Tree, system: Equations, attitude: Tensor, fluid: LinkFluid) -> Equations:
    """Add the fluid to equations of motion; its velocity terms use the motion of the equations.

    Args:
        attitude: Base to world, xyzw, (E, 4).
    """
    places, motion, turn = system.places, system.motion, system.motion.ang_vel
    wind = quat_rotate_inverse(attitude, fluid.wind).unsqueeze(1)
    through = motion.lin_vel + cross(turn, places.com - places.origin) - wind
    velocity = torch.cat((places.to_link(through), places.to_link(turn)), dim=-1)
    change = center_change(system, places.to_link(cross(turn, wind.expand_as(turn))))
    return add_at_centers(tree, system, fluid.added, fluid_wrench(fluid.added, velocity, change))
