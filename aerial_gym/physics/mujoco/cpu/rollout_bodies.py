"""Free bodies in MuJoCo on the CPU, in float64.

Letters: E environments, N rows of parameters: 1 where all environments share them, else E.
"""

from copy import copy

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.physics.mujoco.bodies import COM, GRAVITY, INERTIA, MASS, Bodies, compile_body, load
from aerial_gym.physics.mujoco.cpu.rollouts import Rollouts
from aerial_gym.physics.mujoco.mjcf import Floor


class RolloutBodies(Bodies):
    """A MuJoCo model for each row of parameters."""

    def __init__(
        self, rows: Tensor, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make the models.

        Args:
            rows: Of ``body_rows``, (N, 14).
            dt: Length of a step [s].
            floor: What can be touched, its spheres in the body frame of the robot file; None for nothing.
            cfg: How it gives way; with a floor.

        Raises:
            MissingDependencyError: If MuJoCo is not installed.
        """
        self._floor, self.dt, self.num_rows = floor, dt, len(rows)
        first = compile_body(load("mujoco", backend="mujoco"), floor, cfg, dt)
        self._rollouts = Rollouts([copy(first) for _ in rows], num_envs, "mjSTATE_XFRC_APPLIED")
        self._rows = torch.full_like(rows, torch.nan)
        self.follow(rows)

    def follow(self, rows: Tensor) -> None:
        """Write the parameters (N, 14) that have changed since the last call into the models."""
        changed = (rows != self._rows).any(dim=-1).nonzero().squeeze(-1).tolist()
        if not changed:
            return
        new = rows[changed]
        self._rows[changed] = new
        inertia = new[:, INERTIA].unflatten(-1, (1, 3, 3))
        mass = new[:, MASS : MASS + 1]
        gravity = torch.zeros_like(new[:, COM])
        gravity[:, 2] = -new[:, GRAVITY]
        self._rollouts.write_bodies(changed, [1], mass, torch.zeros_like(inertia[..., 0]), inertia, gravity)
        if self._floor is not None:
            centers = np.asarray(self._floor.spheres)[:, :3]
            for k, com in zip(changed, new[:, COM].numpy(), strict=True):
                self._rollouts.models[k].geom_pos[1:] = centers - com
        self._rollouts.settle(changed)

    def _inputs(self) -> tuple[Tensor, Tensor, Tensor]:
        all_, start = self._rollouts, self._rollouts.start
        return start[:, all_.pose], start[:, all_.twist], all_.control[:, 6:]

    def _step(self) -> None:
        self._rollouts.step()

    def _outputs(self) -> tuple[Tensor, Tensor]:
        end = self._rollouts.end
        return end[:, self._rollouts.pose], end[:, self._rollouts.twist]
