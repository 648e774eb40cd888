"""Trees of rigid links: topology, joints and masses.

Each joint has one degree of freedom and carries one link; a universal joint is two joints with a massless link between.
Link 0 is the base; joint k carries link k + 1, so that a parent always has a smaller number than its child.
Frames: a link's frame is its joint's, turned or moved by the joint; SI units.
Letters: E environments, D joints, L = D + 1 links.
"""

from dataclasses import dataclass
from functools import cached_property
from math import isclose, isfinite, sqrt
from typing import Literal

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A joint of one degree of freedom, with its pose on its parent."""

    parent: int  # Index of the parent link

    kind: Literal["revolute", "prismatic"] = "revolute"

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)  # Unit vector of rotation or translation, in the joint's frame
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Origin of the joint's frame on its parent [m]
    attitude: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # At coordinate zero, joint to parent, xyzw

    def __post_init__(self) -> None:
        """Refuse invalid values."""
        numbers = (*self.axis, *self.position, *self.attitude)
        if not all(isfinite(number) for number in numbers):
            raise ConfigError(f"a joint on link {self.parent} has numbers that are not finite")
        if self.kind not in ("revolute", "prismatic"):
            raise ConfigError(f"a joint on link {self.parent} is {self.kind!r}: choose revolute or prismatic")
        for name, values in (("axis", self.axis), ("attitude", self.attitude)):
            length = sqrt(sum(value * value for value in values))
            if not isclose(length, 1.0, abs_tol=1e-6):
                raise ConfigError(f"a joint on link {self.parent}: {name} has length {length:.6g}, and must have 1")


@dataclass(frozen=True, kw_only=True)
class Tree:
    """Topology of links; the same in all environments."""

    joints: tuple[Joint, ...]
    floating: bool = True  # Whether the base moves; else it is fixed

    def __post_init__(self) -> None:
        """Refuse joints on later or missing links."""
        for k, joint in enumerate(self.joints):
            if not 0 <= joint.parent <= k:
                raise ConfigError(
                    f"joint {k} is on link {joint.parent}: a parent is 0, the base, or an earlier link (up to {k})"
                )

    @property
    def num_joints(self) -> int:
        """Number D of joints."""
        return len(self.joints)

    @property
    def num_links(self) -> int:
        """Number L of links, the base among them."""
        return len(self.joints) + 1

    def children(self, link: int) -> tuple[int, ...]:
        """Return the indices of the joints on a link."""
        return tuple(k for k, joint in enumerate(self.joints) if joint.parent == link)

    @cached_property
    def joint_moves_link(self) -> tuple[tuple[bool, ...], ...]:
        """Return whether each joint moves each link: L rows of D."""
        rows = [(False,) * self.num_joints]
        for k, joint in enumerate(self.joints):
            rows.append(tuple(above or k == place for place, above in enumerate(rows[joint.parent])))
        return tuple(rows)


@dataclass(frozen=True, kw_only=True)
class Links:
    """Masses, centres of mass and inertias of links; the first dimension is E, or 1 if shared."""

    mass: Tensor  # [kg], (E, L); zero for a link between the two joints of a universal one
    com: Tensor  # Centres of mass [m], axes of each link, (E, L, 3)
    inertia: Tensor  # About the centres of mass [kg m²], axes of each link, (E, L, 3, 3)

    @property
    def total_mass(self) -> Tensor:
        """Total mass [kg], (E, 1)."""
        return self.mass.sum(-1, keepdim=True)


@dataclass(frozen=True, kw_only=True)
class TreeState:
    """Motion of the base and of the joints."""

    position: Tensor  # Of the base's origin [m], world, (E, 3)
    attitude: Tensor  # Base to world, xyzw, (E, 4)
    lin_vel: Tensor  # Of the base's origin [m/s], world, (E, 3)
    ang_vel: Tensor  # Of the base [rad/s], base axes, (E, 3)
    joint_pos: Tensor  # [rad] or [m], (E, D)
    joint_vel: Tensor  # [rad/s] or [m/s], (E, D)

    @classmethod
    def at_rest(cls, num_envs: int, num_joints: int, *, like: Tensor) -> "TreeState":
        """Return trees at rest at the origin, with float type and device of ``like``."""
        attitude = like.new_zeros(num_envs, 4)
        attitude[:, 3] = 1.0
        three, joints = like.new_zeros(num_envs, 3), like.new_zeros(num_envs, num_joints)
        return cls(
            position=three,
            attitude=attitude,
            lin_vel=torch.zeros_like(three),
            ang_vel=torch.zeros_like(three),
            joint_pos=joints,
            joint_vel=torch.zeros_like(joints),
        )
