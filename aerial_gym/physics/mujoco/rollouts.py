"""MuJoCo on the CPU, in float64: threaded rollout of one step of all environments, for free bodies and trees of links.

Letters: E environments, N models or rows of parameters: 1 if shared by all environments, else E; L links, D joints.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.physics.articulated.tree import Links, Tree
from aerial_gym.physics.mujoco import bodies
from aerial_gym.physics.mujoco.mjcf import Floor, check_solids, solver_numbers
from aerial_gym.physics.mujoco.trees import MujocoTrees, template_mjcf


class Rollouts:
    """Models with a threaded rollout, with torch's number of threads."""

    def __init__(self, models: Sequence[Any], num_envs: int, *control: str) -> None:
        """Allocate the rollout of N ``MjModel`` of equal structure; ``control`` are entries of ``mjtState`` in its order."""
        self.mujoco, rollout = (bodies.import_optional(name, backend="mujoco") for name in ("mujoco", "mujoco.rollout"))
        self.models, self._num_envs, xml_model = list(models), num_envs, models[0]
        self._scratch = self.mujoco.MjData(xml_model)
        self.replace_models({})
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
        """State at the start of a step: time, qpos and qvel, (E, 1 + nq + nv)."""
        return torch.from_numpy(self._start)

    @property
    def control(self) -> Tensor:
        """Constant inputs of a step, (E, ...)."""
        return torch.from_numpy(self._control)[:, 0]

    @property
    def end(self) -> Tensor:
        """State at the end of a step, as ``start``."""
        return torch.from_numpy(self._end)[:, 0]

    @property
    def sensor_values(self) -> Tensor:
        """Sensor values at the start of a step, (E, ...)."""
        return torch.from_numpy(self._sensed)[:, 0]

    def replace_models(self, models: Mapping[int, Any]) -> None:
        """Replace some models."""
        for k, model in models.items():
            self.models[k] = model
        for model in self.models:
            model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_AUTORESET  # on divergence
        self._of_env = self.models * (self._num_envs // len(self.models))

    def step(self) -> None:
        """Advance from ``start`` to ``end``."""
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
        """Write masses [kg], (K, L), centres of mass [m], inertias [kg m²] and free fall [m/s²], (K, 3), into K models."""
        moments, turns = bodies.principal_axes(self.mujoco, inertia)
        for k, *of_model, fall in zip(changed, *(t.numpy() for t in (mass, com, moments, turns, gravity)), strict=True):
            model = self.models[k]
            model.body_mass[places], model.body_ipos[places], model.body_inertia[places], axes = of_model
            model.body_iquat[places], model.opt.gravity[:] = axes, fall

    def scale_contacts(self, changed: list[int], places: list[int], mass: Tensor) -> None:
        """Scale the contacts of bodies in some models by the whole mass [kg], (K,), instead of that of one link."""
        for k, whole in zip(changed, mass.tolist(), strict=True):
            self.models[k].body_invweight0[places, 0] = 1.0 / whole

    def update_constants(self, changed: list[int]) -> None:
        """Let MuJoCo update the derived constants of some models."""
        for k in changed:
            self.mujoco.mj_setConst(self.models[k], self._scratch)


class RolloutBodies(bodies.Bodies):
    """A MuJoCo model for each row of parameters."""

    def __init__(
        self, rows: Tensor, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make the models with the parameters of ``body_rows``, (N, 14), for steps of ``dt`` [s]."""
        self._floor, self.dt, self.num_rows = floor, dt, len(rows)
        first = bodies.compile_template_body(bodies.import_optional("mujoco", backend="mujoco"), floor, cfg, dt)
        self._rollouts = Rollouts([copy(first) for _ in rows], num_envs, "mjSTATE_XFRC_APPLIED")
        self._rows = torch.full_like(rows, torch.nan)
        self.set_parameters(rows)

    def set_parameters(self, rows: Tensor) -> None:
        """Write the changed parameters of (N, 14) into the models."""
        changed = (rows != self._rows).any(dim=-1).nonzero().squeeze(-1).tolist()
        if not changed:
            return
        new = rows[changed]
        self._rows[changed] = new
        inertia = new[:, bodies.INERTIA].unflatten(-1, (1, 3, 3))
        mass = new[:, bodies.MASS : bodies.MASS + 1]
        gravity = torch.zeros_like(new[:, bodies.COM])
        gravity[:, 2] = -new[:, bodies.GRAVITY]
        self._rollouts.write_bodies(changed, [1], mass, torch.zeros_like(inertia[..., 0]), inertia, gravity)
        if self._floor is not None:
            centers = np.asarray(self._floor.spheres)[:, :3]
            for k, com in zip(changed, new[:, bodies.COM].numpy(), strict=True):
                self._rollouts.models[k].geom_pos[1:] = centers - com
        self._rollouts.update_constants(changed)

    def _inputs(self) -> tuple[Tensor, Tensor, Tensor]:
        all_, start = self._rollouts, self._rollouts.start
        return start[:, all_.pose], start[:, all_.twist], all_.control[:, 6:]

    def _step(self) -> None:
        self._rollouts.step()

    def _outputs(self) -> tuple[Tensor, Tensor]:
        end = self._rollouts.end
        return end[:, self._rollouts.pose], end[:, self._rollouts.twist]


class RolloutTrees(MujocoTrees):
    """A MuJoCo model for each environment."""

    backend = "mujoco"

    def __init__(
        self, tree: Tree, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make the models for steps of ``dt`` [s], with ground and obstacles where there is contact."""
        solids = None if floor is None else floor.solids
        if solids is not None:
            check_solids(solids)
            self._part = solids.part.clone()
        self._floor, self._cfg = floor, cfg
        models = self._compile(list(range(num_envs)), tree, dt)
        super().__init__(models[0], tree, num_envs, dt, solids=solids, touches=floor is not None)
        held = ("mjSTATE_CTRL", "mjSTATE_MOCAP_POS", "mjSTATE_MOCAP_QUAT")
        self._rollouts = Rollouts(list(models.values()), num_envs, *held)

    def _compile(self, envs: list[int], tree: Tree, dt: float) -> dict[int, Any]:
        """Compile template models of some environments; each kind is compiled once."""
        mujoco, kinds, models = bodies.import_optional("mujoco", backend="mujoco"), {}, {}
        for env in envs:
            kind = (
                ()
                if self._floor is None or self._floor.solids is None
                else tuple(self._floor.solids.part[env].tolist())
            )
            if kind not in kinds:
                text = template_mjcf(tree, dt, floor=self._floor, env=env)
                model = kinds[kind] = mujoco.MjModel.from_xml_string(text)
                if self._cfg is not None:
                    numbers = solver_numbers(self._cfg, dt)
                    model.geom_solref[:], model.geom_solimp[:] = model.pair_solref[:], model.pair_solimp[:] = numbers
            models[env] = copy(kinds[kind])
        return models

    def _write_changes(self, links: Links, gravity: float, armature: Tensor) -> None:
        self._rebuild_models()
        super()._write_changes(links, gravity, armature)

    def _rebuild_models(self) -> None:
        """Rebuild the models of environments with new obstacles."""
        if self._solids is None:
            return
        changed = (self._solids.part != self._part).any(dim=-1).nonzero().squeeze(-1).tolist()
        if changed:
            self._part.copy_(self._solids.part)
            self._rollouts.replace_models(self._compile(changed, self._tree, self.dt))
            self._weights[changed] = self._armature[changed] = torch.nan

    def _write_links(self, changed: list[int], mass: Tensor, com: Tensor, inertia: Tensor, down: Tensor) -> None:
        self._rollouts.write_bodies(changed, self._places, mass, com, inertia, down)
        self._rollouts.update_constants(changed)
        if self._touches:
            self._rollouts.scale_contacts(changed, self._places, mass.sum(dim=-1))

    def _write_armature(self, changed: list[int], armature: Tensor) -> None:
        for k, row in zip(changed, armature.numpy(), strict=True):
            self._rollouts.models[k].dof_armature[self._rates] = row

    def _run(self, start: Tensor, control: Tensor) -> tuple[Tensor, Tensor | None]:
        self._rollouts.start[:, 1:] = start
        self._rollouts.control.copy_(control)
        self._rollouts.step()
        return self._rollouts.end[:, 1:], self._rollouts.sensor_values.unflatten(-1, (-1, 3)).sum(
            1
        ) if self._touches else None
