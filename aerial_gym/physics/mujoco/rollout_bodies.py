"""Free bodies in MuJoCo on the CPU, all advanced in one call of its threaded rollout, in float64.

Letters: E environments, N rows of parameters: 1 where all environments share them, else E.
"""

import copy

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.physics.mujoco.bodies import COM, GRAVITY, INERTIA, MASS, Bodies, compile_body, load
from aerial_gym.physics.mujoco.mjcf import Floor

_WIDTH = 14
"""Of MuJoCo's full state of a free body: time, qpos, qvel."""

_POSE, _TWIST = slice(1, 8), slice(8, 14)


class RolloutBodies(Bodies):
    """A MuJoCo model for each row of parameters, and a thread for each that torch uses."""

    def __init__(
        self, rows: Tensor, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make the models.

        Args:
            rows: Of ``body_rows``, (N, 14).
            num_envs: Environments E.
            dt: Length of a step [s].
            floor: What can be touched, its spheres in the body frame of the robot file; None for nothing.
            cfg: How it gives way; with a floor.

        Raises:
            MissingDependencyError: If MuJoCo is not installed.
        """
        self._mujoco, rollout = (load(name, backend="mujoco") for name in ("mujoco", "mujoco.rollout"))
        self._floor, self.dt, self.num_rows = floor, dt, len(rows)
        first = compile_body(self._mujoco, floor, cfg, dt)
        first.opt.disableflags |= (
            self._mujoco.mjtDisableBit.mjDSBL_AUTORESET
        )  # of a body that accelerates beyond measure
        self._models = [first, *(copy.copy(first) for _ in range(len(rows) - 1))]
        self._scratch = self._mujoco.MjData(first)
        self._rows = torch.full_like(rows, torch.nan)
        self.follow(rows)
        self._of_env = self._models * (num_envs // len(rows))
        threads = torch.get_num_threads()
        self._data = [self._mujoco.MjData(first) for _ in range(threads)]
        self._rollout = rollout.Rollout(nthread=threads if threads > 1 else 0)  # 0: the calling thread
        self._spec = self._mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
        self._start, self._push = np.zeros((num_envs, _WIDTH)), np.zeros((num_envs, 1, 12))
        self._end, self._sensed = np.zeros((num_envs, 1, _WIDTH)), np.zeros((num_envs, 1, 0))

    def follow(self, rows: Tensor) -> None:
        """Write the parameters (N, 14) that have changed since the last call into the models."""
        changed = (rows != self._rows).any(dim=-1).nonzero().squeeze(-1).tolist()
        if not changed:
            return
        moments, axes = torch.linalg.eigh(rows[changed, INERTIA].unflatten(-1, (3, 3)))
        axes[..., 0] *= torch.linalg.det(axes).sign().unsqueeze(-1)
        for k, row, moment, axis in zip(changed, rows[changed].numpy(), moments.numpy(), axes.numpy(), strict=True):
            model = self._models[k]
            model.body_mass[1], model.body_inertia[1], model.opt.gravity[2] = row[MASS], moment, -row[GRAVITY]
            self._mujoco.mju_mat2Quat(model.body_iquat[1], axis.flatten())
            if self._floor is not None:
                model.geom_pos[1:] = np.asarray(self._floor.spheres)[:, :3] - row[COM]
            self._mujoco.mj_setConst(model, self._scratch)
        self._rows[changed] = rows[changed]

    def _inputs(self) -> tuple[Tensor, Tensor, Tensor]:
        start = torch.from_numpy(self._start)
        return start[:, _POSE], start[:, _TWIST], torch.from_numpy(self._push)[:, 0, 6:]

    def _step(self) -> None:
        self._rollout.rollout(
            self._of_env,
            self._data,
            self._start,
            self._push,
            control_spec=self._spec,
            skip_checks=True,
            nstep=1,
            state=self._end,
            sensordata=self._sensed,
        )

    def _outputs(self) -> tuple[Tensor, Tensor]:
        end = torch.from_numpy(self._end)[:, 0]
        return end[:, _POSE], end[:, _TWIST]
