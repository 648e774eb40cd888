"""What follows a vehicle from substep to substep: a record of where it goes, or surroundings that push it.

A backend advances all substeps of a step in one go. Whoever must know each of them gives it a hook at ``allocate``: the torch
backend calls it after every substep, the fused kernel holds its Warp twin, composed in only where there is one.
Letters: E environments, K substeps of a step, D joints.
"""

from dataclasses import dataclass
from typing import Protocol

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.physics.fused.hook import FusedHook, trajectory_hook
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.state import BodyState, JointedState


class SubstepHook(Protocol):
    """Is told every substep, after contact with the ground, and may change the motion in place."""

    @property
    def max_substeps(self) -> int | None:
        """How many substeps a step may have; None for any number."""
        ...

    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Follow substep ``k``, counted from 0, which led from ``before`` to ``state``; waits for nothing."""
        ...

    def fused(self) -> FusedHook:
        """Return the same as Warp code, in which a thread follows one environment."""
        ...


def check_substeps(hook: SubstepHook | None, substeps: int) -> None:
    """Raise ``ShapeError`` if a hook has no room for so many substeps."""
    if hook is not None and hook.max_substeps is not None and substeps > hook.max_substeps:
        raise ShapeError(f"substeps = {substeps}: {type(hook).__name__} has room for {hook.max_substeps}")


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """A hook that records the pose after every substep. Rows beyond the substeps of a step are left alone."""

    position: Tensor
    """Body origin [m], world, float32, (K, E, 3)."""

    attitude: Tensor
    """Body to world, xyzw, float32, (K, E, 4)."""

    joint_pos: Tensor | None = None
    """Of a vehicle that bends: coordinates of its joints [rad] or [m], float32, (K, E, D)."""

    @classmethod
    def zeros(cls, substeps: int, num_envs: int, *, device: torch.device, num_joints: int = 0) -> "Trajectory":
        """Return a record with room for steps of so many substeps, and for joints if there are any."""
        size = (substeps, num_envs)
        return cls(
            position=torch.zeros(*size, 3, device=device),
            attitude=torch.zeros(*size, 4, device=device),
            joint_pos=torch.zeros(*size, num_joints, device=device) if num_joints else None,
        )

    @property
    def max_substeps(self) -> int:
        """Room for that many, K."""
        return self.position.shape[0]

    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Write row ``k``."""
        del before
        self.position[k].copy_(state.position)
        self.attitude[k].copy_(state.attitude)
        if self.joint_pos is not None:
            assert isinstance(state, JointedState)
            self.joint_pos[k].copy_(state.joint_pos)

    def fused(self) -> FusedHook:
        """Return the same as Warp code."""
        position = wp.from_torch(self.position, dtype=wp.vec3)
        joint_pos = None if self.joint_pos is None else wp.from_torch(self.joint_pos)
        return trajectory_hook(position, wp.from_torch(self.attitude, dtype=wp.quat), joint_pos)
