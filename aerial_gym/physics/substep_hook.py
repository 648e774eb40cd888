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

from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.physics.fused.hook import FusedHook, trajectory_hook
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.state import BodyState, JointedState


class SubstepHook(Protocol):
    """Is told every substep, after contact with the ground, and may change the motion in place."""

    @property
    def max_substeps(self) -> int | None:
        """How many substeps a step may have; None for any number."""
        ...

    def begin(self, state: BodyState) -> None:
        """Take the state at which a step starts; called before substep 0, waits for nothing."""
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


@dataclass(kw_only=True)
class Trajectory:
    """A hook that records the poses of a step: row 0 at its start, row k + 1 after substep k.

    Rows beyond the substeps of a step are left alone.
    """

    position: Tensor  # Body origin [m], world, float32, (K + 1, E, 3)
    attitude: Tensor  # Body to world, xyzw, float32, (K + 1, E, 4)
    joint_pos: Tensor | None = None  # Coordinates of the joints of an articulated vehicle [rad, m], (K + 1, E, D)
    _began: bool = False

    @classmethod
    def zeros(cls, substeps: int, num_envs: int, *, device: torch.device, num_joints: int = 0) -> "Trajectory":
        """Return a record with room for steps of so many substeps, and for joints if there are any."""
        size = (substeps + 1, num_envs)
        return cls(
            position=torch.zeros(*size, 3, device=device),
            attitude=torch.zeros(*size, 4, device=device),
            joint_pos=torch.zeros(*size, num_joints, device=device) if num_joints else None,
        )

    @property
    def max_substeps(self) -> int:
        """Room for that many, K."""
        return self.position.shape[0] - 1

    def begin(self, state: BodyState) -> None:
        """Write row 0."""
        self._write(0, state)
        self._began = True

    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Write row ``k + 1``; raise ``CapabilityError`` if the backend did not call ``begin`` in this step."""
        del before
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
            assert isinstance(state, JointedState)
            self.joint_pos[row].copy_(state.joint_pos)

    def fused(self) -> FusedHook:
        """Return the same as Warp code."""
        position = wp.from_torch(self.position, dtype=wp.vec3)
        joint_pos = None if self.joint_pos is None else wp.from_torch(self.joint_pos)
        return trajectory_hook(position, wp.from_torch(self.attitude, dtype=wp.quat), joint_pos)
