"""Hooks after each substep: a record of poses, or forces of the surroundings.

A backend advances all substeps of a step in one call. A hook, given at ``allocate``, runs after every substep: the torch
backend calls it, and the fused kernel includes its Warp version.
Letters: E environments, K substeps of a step, D joints.
"""

from dataclasses import dataclass
from typing import Protocol

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.physics.fused.hook import FusedHook, trajectory_hook
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.state import ArticulatedState, BodyState


class SubstepHook(Protocol):
    """Function after every substep and its contact with the ground; it may change the motion in place."""

    @property
    def max_substeps(self) -> int | None:
        """Largest number of substeps of a step; None for any number."""
        ...

    def begin(self, state: BodyState) -> None:
        """Process the state at the start of a step, before substep 0, without waiting for the device."""
        ...

    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Process substep ``k`` (from 0), from ``before`` to ``state``, without waiting for the device."""
        ...

    def fused(self) -> FusedHook:
        """Return the Warp version, with one thread per environment."""
        ...


def check_substeps(hook: SubstepHook | None, substeps: int) -> None:
    """Raise ``ShapeError`` if the number of substeps exceeds that of a hook."""
    if hook is not None and hook.max_substeps is not None and substeps > hook.max_substeps:
        raise ShapeError(f"substeps = {substeps}: {type(hook).__name__} has room for {hook.max_substeps}")


@dataclass(kw_only=True)
class Trajectory:
    """Hook that records the poses of a step: row 0 at its start, row k + 1 after substep k. Further rows stay unchanged."""

    position: Tensor  # Body origin [m], world, float32, (K + 1, E, 3)
    attitude: Tensor  # Body to world, xyzw, float32, (K + 1, E, 4)
    joint_pos: Tensor | None = None  # Coordinates of the joints of an articulated vehicle [rad, m], (K + 1, E, D)
    _began: bool = False

    @classmethod
    def zeros(cls, substeps: int, num_envs: int, *, device: torch.device, num_joints: int = 0) -> "Trajectory":
        """Allocate a record for steps of ``substeps``, with joints if there are any."""
        size = (substeps + 1, num_envs)
        return cls(
            position=torch.zeros(*size, 3, device=device),
            attitude=torch.zeros(*size, 4, device=device),
            joint_pos=torch.zeros(*size, num_joints, device=device) if num_joints else None,
        )

    @property
    def max_substeps(self) -> int:
        """Capacity in substeps, K."""
        return self.position.shape[0] - 1

    def begin(self, state: BodyState) -> None:
        """Write row 0."""
        self._write(0, state)
        self._began = True

    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Write row ``k + 1``; raise ``CapabilityError`` if the backend did not call ``begin`` in this step."""
        if k == 0 and not self._began:
            raise CapabilityError(
                "Trajectory: the start of the step is unknown. A backend calls begin(state) before substep 0"
            )
        self._began = False
        self._write(k + 1, state)

    def _write(self, row: int, state: BodyState) -> None:
        self.position[row].copy_(state.position)
        self.attitude[row].copy_(state.attitude)
        if self.joint_pos is not None:
            assert isinstance(state, ArticulatedState)
            self.joint_pos[row].copy_(state.joint_pos)

    def fused(self) -> FusedHook:
        """Return the Warp version."""
        position = wp.from_torch(self.position, dtype=wp.vec3)
        joint_pos = None if self.joint_pos is None else wp.from_torch(self.joint_pos)
        return trajectory_hook(position, wp.from_torch(self.attitude, dtype=wp.quat), joint_pos)
