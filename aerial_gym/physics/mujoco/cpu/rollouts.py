"""MuJoCo's threaded rollout of one step of all environments, with models, states and controls kept in place.

Letters: E environments, N models: 1 where all environments share it, else E.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.physics.mujoco.bodies import load, principal_axes


class Rollouts:
    """Models, and a thread for each that torch uses."""

    def __init__(self, models: Sequence[Any], num_envs: int, *control: str) -> None:
        """Take the models.

        Args:
            models: An ``MjModel`` each, N of them, that differ in numbers alone, not in how many of each thing there are.
            control: What is held over a step, entries of ``mjtState`` in the order of that.
        """
        self.mujoco, rollout = (load(name, backend="mujoco") for name in ("mujoco", "mujoco.rollout"))
        self.models, self._num_envs, xml_model = list(models), num_envs, models[0]
        self._scratch = self.mujoco.MjData(xml_model)
        self.replace({})
        threads = torch.get_num_threads()
        self._data = [self.mujoco.MjData(xml_model) for _ in range(threads)]
        self._rollout = rollout.Rollout(nthread=threads if threads > 1 else 0)  # 0: the calling thread
        self._spec = sum(getattr(self.mujoco.mjtState, each).value for each in control)
        width = 1 + xml_model.nq + xml_model.nv  # the time, qpos, qvel
        self._start, self._end = np.zeros((num_envs, width)), np.zeros((num_envs, 1, width))
        self._control = np.zeros((num_envs, 1, self.mujoco.mj_stateSize(xml_model, self._spec)))
        self._sensed = np.zeros((num_envs, 1, xml_model.nsensordata))
        self.pose, self.twist = slice(1, 1 + xml_model.nq), slice(1 + xml_model.nq, width)

    @property
    def start(self) -> Tensor:
        """Where a step begins: time, qpos and qvel, (E, 1 + nq + nv)."""
        return torch.from_numpy(self._start)

    @property
    def control(self) -> Tensor:
        """What is held over it, (E, ...)."""
        return torch.from_numpy(self._control)[:, 0]

    @property
    def end(self) -> Tensor:
        """Where a step ends, as ``start``."""
        return torch.from_numpy(self._end)[:, 0]

    @property
    def sensed(self) -> Tensor:
        """What sensors measured at the start of a step, (E, ...)."""
        return torch.from_numpy(self._sensed)[:, 0]

    def replace(self, models: Mapping[int, Any]) -> None:
        """Take other models in the places of some."""
        for k, model in models.items():
            self.models[k] = model
        for model in self.models:
            model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_AUTORESET  # of what accelerates beyond measure
        self._of_env = self.models * (self._num_envs // len(self.models))

    def step(self) -> None:
        """Go from ``start`` to ``end``."""
        self._rollout.rollout(
            self._of_env,
            self._data,
            self._start,
            self._control,
            control_spec=self._spec,
            skip_checks=True,
            nstep=1,
            state=self._end,
            sensordata=self._sensed,
        )

    def write_bodies(
        self, changed: list[int], places: list[int], mass: Tensor, com: Tensor, inertia: Tensor, gravity: Tensor
    ) -> None:
        """Write what bodies weigh into some models.

        Args:
            places: MuJoCo's numbers of the bodies, L of them.
            mass: Of each [kg], (K, L).
            com: Centres of mass, axes of each body [m], (K, L, 3).
            inertia: About these [kg m²], (K, L, 3, 3).
            gravity: Acceleration of free fall, world [m/s²], (K, 3).
        """
        moments, turns = principal_axes(self.mujoco, inertia)
        for k, *of_model, fall in zip(changed, *(t.numpy() for t in (mass, com, moments, turns, gravity)), strict=True):
            model = self.models[k]
            model.body_mass[places], model.body_ipos[places], model.body_inertia[places], axes = of_model
            model.body_iquat[places], model.opt.gravity[:] = axes, fall

    def refer_contacts_to(self, changed: list[int], places: list[int], mass: Tensor) -> None:
        """Let contacts of bodies in some models give way by the mass of the whole [kg], (K,), not by that of a link alone."""
        for k, whole in zip(changed, mass.tolist(), strict=True):
            self.models[k].body_invweight0[places, 0] = 1.0 / whole

    def settle(self, changed: list[int]) -> None:
        """Let MuJoCo work out what follows from the numbers that were written into some models."""
        for k in changed:
            self.mujoco.mj_setConst(self.models[k], self._scratch)
