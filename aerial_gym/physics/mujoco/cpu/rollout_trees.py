"""Trees of links in MuJoCo on the CPU, in float64, with what they touch: a model for each environment.

Letters: E environments, L links, D joints, P parts of obstacles.
"""

from copy import copy
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.physics.articulated.tree import Links, Tree
from aerial_gym.physics.mujoco.bodies import load
from aerial_gym.physics.mujoco.cpu.rollouts import Rollouts
from aerial_gym.physics.mujoco.mjcf import Floor
from aerial_gym.physics.mujoco.softness import solver_numbers
from aerial_gym.physics.mujoco.solid_bodies import check_solids
from aerial_gym.physics.mujoco.trees import Trees, template


class RolloutTrees(Trees):
    """A MuJoCo model for each environment."""

    backend = "mujoco"

    def __init__(
        self, tree: Tree, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make the models.

        Args:
            dt: Length of a step [s].
            floor: What can be touched; None for nothing.
            cfg: How it gives way; with a floor.

        Raises:
            MissingDependencyError: If MuJoCo is not installed.
            CapabilityError: If an obstacle has a shape that MuJoCo has not.
        """
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
        """Return the models of some environments, into which weights can be written; each of a kind is read once."""
        mujoco, kinds, found = load("mujoco", backend="mujoco"), {}, {}
        for env in envs:
            kind = (
                ()
                if self._floor is None or self._floor.solids is None
                else tuple(self._floor.solids.part[env].tolist())
            )
            if kind not in kinds:
                text = template(tree, dt, floor=self._floor, env=env)
                model = kinds[kind] = mujoco.MjModel.from_xml_string(text)
                if self._cfg is not None:
                    numbers = solver_numbers(self._cfg, dt)
                    model.geom_solref[:], model.geom_solimp[:] = model.pair_solref[:], model.pair_solimp[:] = numbers
            found[env] = copy(kinds[kind])
        return found

    def _follow(self, links: Links, gravity: float, armature: Tensor) -> None:
        self._renew()
        super()._follow(links, gravity, armature)

    def _renew(self) -> None:
        """Make the models anew of environments whose obstacles have become others."""
        if self._solids is None:
            return
        changed = (self._solids.part != self._part).any(dim=-1).nonzero().squeeze(-1).tolist()
        if changed:
            self._part.copy_(self._solids.part)
            self._rollouts.replace(self._compile(changed, self._tree, self.dt))
            self._weights[changed] = self._armature[changed] = torch.nan

    def _write_links(self, changed: list[int], mass: Tensor, com: Tensor, inertia: Tensor, down: Tensor) -> None:
        self._rollouts.write_bodies(changed, self._places, mass, com, inertia, down)
        self._rollouts.settle(changed)
        if self._touches:
            self._rollouts.refer_contacts_to(changed, self._places, mass.sum(dim=-1))

    def _write_armature(self, changed: list[int], armature: Tensor) -> None:
        for k, row in zip(changed, armature.numpy(), strict=True):
            self._rollouts.models[k].dof_armature[self._rates] = row

    def _run(self, start: Tensor, control: Tensor) -> tuple[Tensor, Tensor | None]:
        self._rollouts.start[:, 1:] = start
        self._rollouts.control.copy_(control)
        self._rollouts.step()
        return self._rollouts.end[:, 1:], self._rollouts.sensed.unflatten(-1, (-1, 3)).sum(1) if self._touches else None
