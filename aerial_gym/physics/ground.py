"""Flat ground: the contact test of a vehicle and, on request, the contact force.

Letters: E environments, C collision spheres.

Obstacles for engines with their own contact detection are a table of shapes, and their poses in each environment:
A obstacles, P parts of all of them.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.math.quaternion import quat_multiply, quat_rotate, quat_rotate_inverse
from aerial_gym.physics.contact import Contacts, apply_contact_impulses
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.model import Model
from aerial_gym.physics.state import BodyState


@dataclass(frozen=True, kw_only=True)
class Solid:
    """A part of an obstacle."""

    kind: str  # Kind of ``config.shape.ShapeCfg``, except ``compound`` and ``urdf``, which have parts
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Half edges of a box [m]; else radius and half length along z
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Position in the obstacle [m]
    attitude: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # Attitude, part to obstacle, xyzw
    path: str = ""  # File of a mesh
    vertices: tuple[tuple[float, float, float], ...] = ()  # Vertices of a mesh [m]
    convex: bool = True  # Whether the mesh is one closed convex body


@dataclass(frozen=True, kw_only=True)
class Solids:
    """Obstacles around the vehicles of all environments; the tensors keep their memory and may be written at any time."""

    table: tuple[Solid, ...]  # All parts
    part: Tensor  # Table row of each part of an environment, -1 for none, integer, (E, P)
    carrier: Tensor  # Index of the obstacle that carries it, integer, (E, P)
    state: Tensor  # Position [m], xyzw, velocity [m/s], angular velocity [rad/s] of obstacles, world, (E, A, 13)
    moves: bool = False  # Whether the velocities count; else they are taken as zero

    @cached_property
    def _poses_in_carriers(self) -> tuple[Tensor, Tensor]:
        """Positions and attitudes of the table's rows in their carriers, float64."""
        kind = {"dtype": torch.float64, "device": self.state.device}
        rows = ([solid.position for solid in self.table], [solid.attitude for solid in self.table])
        return torch.tensor(rows[0], **kind), torch.tensor(rows[1], **kind)

    def motion_of_parts(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return poses and velocities of all parts, float64.

        Returns:
            Positions [m], world, (E, P, 3); attitudes, part to world, xyzw, (E, P, 4); velocities of the parts' origins [m/s],
            world, and angular velocities [rad/s], axes of the part, (E, P, 3). Absent parts are at the world's origin.
        """
        there = (self.part >= 0).unsqueeze(-1)
        row, carrier = self.part.long().clamp_min(0), self.carrier.long().clamp_min(0)
        offset, turn = (values[row] for values in self._poses_in_carriers)
        state = self.state.double().gather(1, carrier.unsqueeze(-1).expand(*carrier.shape, 13))
        position, attitude, lin_vel, ang_vel = state.split((3, 4, 3, 3), dim=-1)
        lever, turned = quat_rotate(attitude, offset), quat_multiply(attitude, turn)
        velocity = lin_vel + torch.linalg.cross(ang_vel, lever)
        unit = torch.zeros_like(turned)
        unit[..., 3] = 1.0
        parts = (position + lever, velocity, quat_rotate_inverse(turned, ang_vel))
        place, velocity, spin = (torch.where(there, values, 0.0) for values in parts)
        return place, torch.where(there, turned, unit), velocity, spin


@dataclass(frozen=True, kw_only=True)
class LinkShape:
    """A sphere, a capsule along z or a box of a link, in link axes: a core with a radius around it."""

    link: int  # Index of the link; 0 for the base
    center: tuple[float, float, float]  # From the origin of the link [m]
    attitude: tuple[float, float, float, float]  # Of the core, xyzw
    half: tuple[float, float, float]  # Half edges of the core [m]: all zero for a sphere, x and y zero for a capsule
    radius: float  # [m]; 0 for a box


@dataclass(frozen=True, kw_only=True)
class LinkContacts:
    """Contact shapes of an articulated vehicle, their pairs and the obstacles."""

    links: tuple[int, ...]  # Link of each sphere that can touch the ground, the base being 0, (C,)
    shapes: tuple[LinkShape, ...] = ()  # Shapes that can touch each other, or obstacles
    pairs: tuple[tuple[int, int], ...] = ()  # Pairs of indices into `shapes` with contact
    solids: Solids | None = None  # Obstacles with contact to `shapes`; None without any


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A horizontal plane, and the shapes of the vehicle that can touch it."""

    height: float  # Height of the plane [m], world; minus infinity for contact to obstacles only
    spheres: Tensor  # Centres in the body frame and radii [m], (C, 4)
    contact: Tensor  # Set to True, (E,), at ground contact, with `cfg` at the speed of a crash. Never cleared here
    cfg: ContactCfg | None = None  # Parameters of the contact force; None without force
    impulse: Tensor | None = None  # With `cfg`: sum of the impulses [N s], world, (E, 3). Never cleared here
    on_links: LinkContacts | None = None  # Contacts of an articulated vehicle; `spheres` are in axes of links


def touches_ground(ground: Ground, state: BodyState) -> Tensor:
    """Return whether the lowest point of a sphere is below the plane, ``p_z + (R c)_z - r < h``, bool (E,)."""
    spheres = ground.spheres.to(state.position.dtype)
    center, radius = spheres[:, :3], spheres[:, 3]
    offset = quat_rotate(state.attitude.unsqueeze(1), center.unsqueeze(0).expand(state.num_envs, -1, -1))
    return (state.position[:, 2:] + offset[..., 2] - radius < ground.height).any(dim=1)


def push_off_ground(
    ground: Ground, cfg: ContactCfg, model: Model, before: MassState, after: MassState, *, dt: float, share: float
) -> tuple[MassState, Tensor, Tensor]:
    """Return the motion with contact, the impulse of the ground [N s], world, (E, 3), and crash flags, bool (E,).

    Args:
        model: Mass, inertia and centre of mass.
        before: Motion at the start of the step, which gives the approach speed.
        after: Motion at the end without contact.
        share: From ``contact.displacement_per_velocity_change``.
    """
    contacts = ground_contacts(ground, model, after)
    crashes = detect_crash(contacts, cfg, before, after)
    state, impulse = apply_contact_impulses(contacts, cfg, model, after, dt=dt, share=share)
    return state, impulse, crashes


def ground_contacts(ground: Ground, model: Model, state: MassState) -> Contacts:
    """Return the possible contacts of a vehicle with the ground, one for every sphere."""
    spheres = ground.spheres.to(state.position.dtype)
    center = spheres[:, :3] - model.vehicle.com.unsqueeze(1)
    offset = quat_rotate(state.attitude.unsqueeze(1), center)
    gap = state.position[:, 2:] + offset[..., 2] - spheres[:, 3] - ground.height
    normal = torch.zeros_like(offset)
    normal[..., 2] = 1.0
    return Contacts(gap=gap, lever=offset - spheres[:, 3:] * normal, normal=normal)


def detect_crash(contacts: Contacts, cfg: ContactCfg, before: MassState, after: MassState) -> Tensor:
    """Return whether a contact after a step is a crash, bool (E,): its approach speed was at least ``cfg.crash_speed``."""
    lever = contacts.lever
    turn = quat_rotate(after.attitude, before.ang_vel).unsqueeze(1).expand_as(lever)
    approach = -(before.lin_vel.unsqueeze(1) + torch.linalg.cross(turn, lever))[..., 2]
    return is_crash(contacts.gap, approach, cfg)


def is_crash(gap: Tensor, approach: Tensor, cfg: ContactCfg) -> Tensor:
    """Return whether any contact with gap [m] and approach speed [m/s], (E, C) each, is a crash, bool (E,)."""
    return ((gap < 0.0) & (approach >= cfg.crash_approach_speed)).any(dim=1)
