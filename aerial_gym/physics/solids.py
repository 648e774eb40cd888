"""Obstacles for engines with their own contact detection: a table of shapes, and their poses in each environment.

Frames: world, z up; a part is in the axes of the obstacle that carries it.
Letters: E environments, A obstacles, P parts of all of them.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_multiply, quat_rotate, quat_rotate_inverse


@dataclass(frozen=True, kw_only=True)
class Solid:
    """A part of an obstacle."""

    kind: str  # Kind of ``config.shape.ShapeCfg``, except ``compound`` and ``urdf``, which have parts

    size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Half edges of a box [m]; else the radius, and half the length of a cylinder or of a capsule's line along z."""

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
