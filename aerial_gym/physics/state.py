"""The state of a batch of multirotors.

Letters: E environments, R rotors, D joints.
"""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class BodyState:
    """Motion of the body origin and speeds of the rotors at one instant."""

    position: Tensor  # Body origin [m], world, (E, 3)
    attitude: Tensor  # Body to world, unit, xyzw, (E, 4)
    lin_vel: Tensor  # Velocity of the body origin [m/s], world, (E, 3)
    ang_vel: Tensor  # Angular velocity [rad/s], body, (E, 3)
    rotor_speed: Tensor  # Rotor speeds [rad/s], (E, R)

    @property
    def num_envs(self) -> int:
        """Number of environments E."""
        return self.position.shape[0]

    def tensors(self) -> tuple[Tensor, ...]:
        """Return the tensors in the order of the fields."""
        return self.position, self.attitude, self.lin_vel, self.ang_vel, self.rotor_speed

    def copy_(self, other: "BodyState") -> None:
        """Write the values of ``other`` into these tensors."""
        for target, source in zip(self.tensors(), other.tensors(), strict=True):
            target.copy_(source)


@dataclass(frozen=True, kw_only=True)
class ArticulatedState(BodyState):
    """State of an articulated vehicle, whose body is the base of a tree of links."""

    joint_pos: Tensor  # Coordinates of the joints [rad] or [m], (E, D)
    joint_vel: Tensor  # Their rates [rad/s] or [m/s], (E, D)

    def tensors(self) -> tuple[Tensor, ...]:
        """Return the tensors in the order of the fields."""
        return *super().tensors(), self.joint_pos, self.joint_vel


@dataclass(frozen=True, kw_only=True)
class JointEfforts:
    """Efforts that drives and dry friction applied to joints over the last substep; zero without them."""

    drive: Tensor  # [N m] or [N], (E, D)
    friction: Tensor  # [N m] or [N], (E, D)


def state_at_rest(num_envs: int, num_rotors: int, *, device: torch.device, dtype: torch.dtype) -> BodyState:
    """Return E bodies at rest at the world origin, level, with rotors at rest."""
    zeros = torch.zeros(num_envs, 3, device=device, dtype=dtype)
    attitude = torch.zeros(num_envs, 4, device=device, dtype=dtype)
    attitude[:, 3] = 1.0
    return BodyState(
        position=zeros,
        attitude=attitude,
        lin_vel=zeros.clone(),
        ang_vel=zeros.clone(),
        rotor_speed=torch.zeros(num_envs, num_rotors, device=device, dtype=dtype),
    )
