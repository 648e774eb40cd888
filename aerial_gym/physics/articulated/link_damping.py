"""Damping of links by the air, evaluated at the end of a step.

The force is ``F = -D u`` in axes of the link, with the velocity u of its centre of mass c through the air. The rate of u in
these axes is ``u' = a_c - w x v_c + w x wind``. The force at the end of a step is ``-D (u + u' dt)`` with the D of its start,
and the torque follows likewise from the angular velocity. The terms in the accelerations add to the mass matrix:
``M + dt sum J^T D J``. So a step is stable for every D.
Letters: E environments, L links, N coordinates of motion.

Source: Hairer, Wanner (1996), Solving Ordinary Differential Equations II, section IV.8 (linearly implicit Euler).
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from aerial_gym.physics.articulated.dynamics import Equations, along_coordinates, sum_of_products
from aerial_gym.physics.articulated.motion import (
    LinkPoses,
    angular_jacobian,
    cross,
    move_links,
    place_links,
    point_jacobian,
)
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
    own = [_to_link(places, part) for part in (through, motion.ang_vel, turned)]
    return torch.cat(own[:2], dim=-1), own[2]


def add_damping(tree: Tree, system: Equations, acts: LinkDamping, dt: float) -> Equations:
    """Add damping at the end of a step of ``dt`` [s] to equations of motion.

    The velocity terms of ``u'`` use the rates of the equations.
    """
    places, motion = system.places, system.motion
    pushes, turns = point_jacobian(tree, places, places.com), angular_jacobian(tree, places)
    along, about = acts.damping.split(3, dim=-1)
    com_vel = motion.lin_vel + cross(motion.ang_vel, places.com - places.origin)
    swing = _to_link(places, motion.com_acc - cross(motion.ang_vel, com_vel)) + acts.turned_wind
    bend = _to_link(places, motion.ang_acc)
    through, turn = (acts.velocity + dt * torch.cat((swing, bend), dim=-1)).split(3, dim=-1)
    mass, force = system.mass, system.force
    for jacobian, damping, value in ((pushes, along, through), (turns, about, turn)):
        own = places.rotation.mT @ jacobian  # (E, L, 3, N), axes of the link
        slowed = damping.unsqueeze(-1) * own
        mass = mass + dt * sum_of_products(own, slowed)
        force = force - along_coordinates(slowed, value)
    return replace(system, mass=mass, force=force)


def _to_link(places: LinkPoses, vectors: Tensor) -> Tensor:
    """Rotate vectors (E, L, 3) from axes of the base into those of their links."""
    return (places.rotation.mT @ vectors.unsqueeze(-1)).squeeze(-1)
