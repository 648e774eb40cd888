"""Free bodies in MuJoCo, one an environment, all advanced in one call of its threaded rollout.

A body's frame stands in its centre of mass, where Newton's and Euler's equations decouple, as in ``integrators``.
Frames: world, z up; body. Letters: E environments, N rows of parameters: 1 where all environments share them, else E.
"""

import copy
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.errors import MissingDependencyError
from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.physics.articulated.tree import Links, Tree
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.model import Model
from aerial_gym.physics.mujoco.mjcf import Floor, write_mjcf
from aerial_gym.physics.mujoco.softness import solver_numbers
from aerial_gym.physics.vehicle import is_shared

LARGEST = 1e9
"""Numbers from here on are not given to MuJoCo, which warns in a file of its own from 1e10 on."""

_TIME, _POSITION, _ATTITUDE, _LIN_VEL, _ANG_VEL = slice(0, 1), slice(1, 4), slice(4, 8), slice(8, 11), slice(11, 14)
_WIDTH = 14
"""Of MuJoCo's full state of a free body: time, position, attitude wxyz, velocity (world), angular velocity (body)."""


def load_mujoco() -> Any:
    """Return the package; raise ``MissingDependencyError`` that names the extra where it is not installed."""
    try:
        import mujoco
        import mujoco.rollout
    except ImportError:
        raise MissingDependencyError("backend 'mujoco' needs MuJoCo: pip install 'aerial-gym[mujoco]'") from None
    return mujoco


def body_rows(model: Model) -> Tensor:
    """Return what MuJoCo must know of each body: mass, inertia, centre of mass and gravity, float64, (N, 14)."""
    vehicle = model.vehicle
    mass, inertia, com = vehicle.mass, vehicle.inertia, vehicle.com
    if all(map(is_shared, (mass, inertia, com))):
        mass, inertia, com = mass[:1], inertia[:1], com[:1]
    gravity = torch.full_like(mass, model.gravity)
    rows = (mass.unsqueeze(-1), inertia.flatten(1), com, gravity.unsqueeze(-1))
    return torch.cat([part.detach().double() for part in rows], dim=-1)


class RigidBodies:
    """The bodies of all environments."""

    def __init__(
        self, rows: Tensor, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make a MuJoCo model for each row and a thread for each that torch uses.

        Args:
            rows: Of ``body_rows``, (N, 14).
            num_envs: Environments E.
            dt: Length of a step [s].
            floor: What can be touched, its spheres in the body frame of the robot file; None for nothing.
            cfg: How it gives way; with a floor.

        Raises:
            MissingDependencyError: If MuJoCo is not installed.
        """
        self._mujoco, self._floor, self.dt = load_mujoco(), floor, dt
        unit = torch.ones(1, 1, dtype=torch.float64)
        links = Links(mass=unit, com=torch.zeros(1, 1, 3), inertia=torch.eye(3).expand(1, 1, 3, 3))
        first = self._mujoco.MjModel.from_xml_string(
            write_mjcf(Tree(joints=()), links, gravity=0.0, dt=dt, floor=floor)
        )
        first.body_sameframe[:] = first.geom_sameframe[:] = 0  # MuJoCo would leave out turns that are none here
        if cfg is not None:
            first.geom_solref[:], first.geom_solimp[:] = solver_numbers(cfg, dt)
        self._models = [first, *(copy.copy(first) for _ in range(len(rows) - 1))]
        self._scratch = self._mujoco.MjData(first)
        self._rows = torch.full_like(rows, torch.nan)
        self.follow(rows)
        self._of_env = self._models * (num_envs // len(rows))
        threads = torch.get_num_threads()
        self._data = [self._mujoco.MjData(first) for _ in range(threads)]
        self._rollout = self._mujoco.rollout.Rollout(nthread=threads)
        self._spec = self._mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
        self._start, self._push = np.zeros((num_envs, _WIDTH)), np.zeros((num_envs, 1, 12))
        self._end, self._sensed = np.zeros((num_envs, 1, _WIDTH)), np.zeros((num_envs, 1, 0))

    @property
    def num_rows(self) -> int:
        """Number N of models."""
        return len(self._models)

    def follow(self, rows: Tensor) -> None:
        """Write the parameters (N, 14) that have changed since the last call into the models."""
        changed = (rows != self._rows).any(dim=-1).nonzero().squeeze(-1).tolist()
        if not changed:
            return
        moments, axes = torch.linalg.eigh(rows[changed, 1:10].unflatten(-1, (3, 3)))
        axes[..., 0] *= torch.linalg.det(axes).sign().unsqueeze(-1)
        for k, row, moment, axis in zip(changed, rows[changed].numpy(), moments.numpy(), axes.numpy(), strict=True):
            model = self._models[k]
            model.body_mass[1], model.body_inertia[1], model.opt.gravity[2] = row[0], moment, -row[13]
            self._mujoco.mju_mat2Quat(model.body_iquat[1], axis.flatten())
            if self._floor is not None:
                model.geom_pos[1:] = np.asarray(self._floor.spheres)[:, :3] - row[10:13]
            self._mujoco.mj_setConst(model, self._scratch)
        self._rows[changed] = rows[changed]

    def move(self, state: MassState, force: Tensor, torque: Tensor) -> dict[str, Tensor]:
        """Return position, attitude and velocities after a step, by the names of ``MassState``, in the float type of ``state``.

        Rows with a number that is not finite, or beyond ``LARGEST``, come out NaN; they are not stepped.

        Args:
            state: Motion of the centre of mass at the start.
            force: Held over the step [N], body at its start, (E, 3).
            torque: About the centre of mass, likewise [N m], (E, 3).
        """
        start, push = torch.from_numpy(self._start), torch.from_numpy(self._push)[:, 0, 6:]
        start[:, _POSITION], start[:, _LIN_VEL], start[:, _ANG_VEL] = state.position, state.lin_vel, state.ang_vel
        start[:, _ATTITUDE] = state.attitude.roll(1, dims=-1)
        attitude = state.attitude.double()
        push[:, :3], push[:, 3:] = quat_rotate(attitude, force.double()), quat_rotate(attitude, torque.double())
        sane = (start.abs() < LARGEST).all(dim=-1) & (push.abs() < LARGEST).all(dim=-1)
        start[~sane], push[~sane] = torch.eye(_WIDTH, dtype=start.dtype)[_ATTITUDE.start], 0.0
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
        end = torch.from_numpy(self._end)[:, 0]
        end[~sane] = torch.nan
        end = end.to(state.position.dtype, copy=True)
        return {
            "position": end[:, _POSITION],
            "attitude": end[:, _ATTITUDE].roll(-1, dims=-1),
            "lin_vel": end[:, _LIN_VEL],
            "ang_vel": end[:, _ANG_VEL],
        }
