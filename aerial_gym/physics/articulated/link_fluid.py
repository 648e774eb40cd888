"""Added mass of links in the equations of motion of a tree: ``LinkFluidEffect``.

A link has added masses A and inertias B at its centre of mass, link axes R. The centre moves at u through fluid in steady
uniform motion and accelerates by a. The fluid then takes the force ``R A R^T (a - w x u) + w x (R A R^T u)`` and the torque
``R B R^T w' + w x (R B R^T w) + u x (R A R^T u)``. The terms in the accelerations add to the mass matrix:
``M + sum J^T (A, B) J``. Added mass has no weight.
Letters: E environments, L links, N coordinates of motion.

Source: Lamb (1932), Hydrodynamics, articles 121-124 (Kirchhoff's equations).
"""

from dataclasses import dataclass, replace

from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics.articulated.dynamics import Equations, along_coordinates, sum_of_products
from aerial_gym.physics.articulated.motion import angular_jacobian, cross, point_jacobian
from aerial_gym.physics.articulated.tree import Tree


@dataclass(frozen=True, kw_only=True)
class LinkFluid:
    """Added mass of each link."""

    added: Tensor  # Diagonals of A [kg] and B [kg m²], axes of the link, (E, L, 6)
    wind: Tensor  # Velocity of the fluid [m/s], world, (E, 3)


def add_fluid(tree: Tree, system: Equations, attitude: Tensor, fluid: LinkFluid) -> Equations:
    """Add the fluid to equations of motion; its velocity terms use the motion of the equations.

    Args:
        attitude: Base to world, xyzw, (E, 4).
    """
    places, motion, turn = system.places, system.motion, system.motion.ang_vel
    along, about = fluid.added.split(3, dim=-1)
    wind = quat_rotate_inverse(attitude, fluid.wind).unsqueeze(1)
    through = motion.lin_vel + cross(turn, places.com - places.origin) - wind

    def apply_added_mass(diagonal: Tensor, vectors: Tensor) -> Tensor:
        own = places.rotation.mT @ vectors.unsqueeze(-1)
        return (places.rotation @ (diagonal.unsqueeze(-1) * own)).squeeze(-1)

    momentum, spin = apply_added_mass(along, through), apply_added_mass(about, turn)
    push = apply_added_mass(along, motion.com_acc - cross(turn, through)) + cross(turn, momentum)
    twist = apply_added_mass(about, motion.ang_acc) + cross(turn, spin) + cross(through, momentum)
    mass, force = system.mass, system.force
    moves, turns = point_jacobian(tree, places, places.com), angular_jacobian(tree, places)
    for rates, diagonal, taken in ((moves, along, push), (turns, about, twist)):
        own = places.rotation.mT @ rates  # (E, L, 3, N), axes of the link
        mass = mass + sum_of_products(own, diagonal.unsqueeze(-1) * own)
        force = force - along_coordinates(rates, taken)
    return replace(system, mass=mass, force=force)
