"""Damping of links by the air, evaluated at the end of a step.

The force is ``F = -D u`` in axes of the link, with the velocity u of its centre of mass c through the air. The rate of u in
these axes is ``u' = a_c - w x v_c + w x wind``. The force at the end of a step is ``-D (u + u' dt)`` with the D of its start,
and the torque follows likewise from the angular velocity. The terms in the accelerations add to the mass matrix:
``M + dt sum J^T D J``. So a step is stable for every D.
Letters: E environments, L links.

Source: Hairer, Wanner (1996), Solving Ordinary Differential Equations II, section IV.8 (linearly implicit Euler).

Added mass of links in the equations of motion of a tree: ``LinkFluidEffect``.

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
from aerial_gym.physics.articulated.dynamics import EquationsOfMotion, add_at_centers, velocity_rates_of_centers
from aerial_gym.physics.articulated.motion import cross, move_links, place_links
from aerial_gym.physics.articulated.tree import Links, Tree


@dataclass(frozen=True, kw_only=True)
class LinkDamping:
    """Damping of each link at the start of a step, in axes of the link."""

    velocity: Tensor  # Of the centres of mass through the air [m/s], and angular velocity [rad/s], (E, L, 6)
    damping: Tensor  # D [N s/m, N m s/rad], (E, L, 6)
    turned_wind: Tensor  # `w x wind` [m/s²], (E, L, 3)

    def start_wrench(self, links: Links) -> Tensor:
        """Return force [N] at the origin of each link and torque [N m], (E, L, 6), at the start of the step."""
        force, torque = (-self.damping * self.velocity).split(3, dim=-1)
        return torch.cat((force, torque + cross(links.com.expand_as(force), force)), dim=-1)


def motion_in_air(
    tree: Tree, links: Links, joint_pos: Tensor, joint_vel: Tensor, lin_vel: Tensor, ang_vel: Tensor, wind: Tensor
) -> tuple[Tensor, Tensor]:
    """Return ``LinkDamping.velocity`` and ``turned_wind``.

    Args:
        joint_pos: Of the joints, (E, D).
        joint_vel: Their rates, (E, D).
        lin_vel: Of the base's origin [m/s], axes of the base, (E, 3).
        ang_vel: Of the base [rad/s], axes of the base, (E, 3).
        wind: Velocity of the air [m/s], axes of the base, (E, 3).
    """
    places = place_links(tree, links, joint_pos)
    motion = move_links(tree, places, lin_vel, ang_vel, joint_vel)
    through = motion.lin_vel + cross(motion.ang_vel, places.com - places.origin) - wind.unsqueeze(1)
    turned = cross(motion.ang_vel, wind.unsqueeze(1).expand_as(through))
    own = [places.to_link(part) for part in (through, motion.ang_vel, turned)]
    return torch.cat(own[:2], dim=-1), own[2]


def damping_at_end(damping: Tensor, velocity: Tensor, change: Tensor, dt: Tensor | float) -> tuple[Tensor, Tensor]:
    """Return the masses that damping adds over a step of ``dt`` [s], and its force and torque without acceleration.

    Args:
        damping: D, (..., 6).
        velocity: u and angular velocity at the start of the step, (..., 6).
        change: Their rates without acceleration (``dynamics.velocity_rates_of_centers``), (..., 6).
    """
    return dt * damping, -damping * (velocity + dt * change)


def add_damping(tree: Tree, system: EquationsOfMotion, acts: LinkDamping, dt: float) -> EquationsOfMotion:
    """Add damping at the end of a step of ``dt`` [s] to equations of motion.

    The velocity terms of ``u'`` use the rates of the equations.
    """
    mass, wrench = damping_at_end(acts.damping, acts.velocity, velocity_rates_of_centers(system, acts.turned_wind), dt)
    return add_at_centers(tree, system, mass, wrench)


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
        change: Their rates without acceleration (``dynamics.velocity_rates_of_centers``), (..., 6).
    """
    (push, twist), (impulse, spin) = ((added * rows).split(3, dim=-1) for rows in (change, velocity))
    through, turn = velocity.split(3, dim=-1)
    force = push + cross(turn, impulse)
    return -torch.cat((force, twist + cross(turn, spin) + cross(through, impulse)), dim=-1)


def add_fluid(tree: Tree, system: EquationsOfMotion, attitude: Tensor, fluid: LinkFluid) -> EquationsOfMotion:
    """Add the fluid to equations of motion; its velocity terms use the motion of the equations.

    Args:
        attitude: Base to world, xyzw, (E, 4).
    """
    places, motion, turn = system.places, system.motion, system.motion.ang_vel
    wind = quat_rotate_inverse(attitude, fluid.wind).unsqueeze(1)
    through = motion.lin_vel + cross(turn, places.com - places.origin) - wind
    velocity = torch.cat((places.to_link(through), places.to_link(turn)), dim=-1)
    change = velocity_rates_of_centers(system, places.to_link(cross(turn, wind.expand_as(turn))))
    return add_at_centers(tree, system, fluid.added, fluid_wrench(fluid.added, velocity, change))
