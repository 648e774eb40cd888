"""Trees of links in MuJoCo Warp, in float32, without contacts.

Letters: E environments, L links, D joints.
"""

import logging

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.interop import on_torch_stream, start_warp
from aerial_gym.physics.articulated.tree import Tree
from aerial_gym.physics.mujoco.bodies import load, principal_axes
from aerial_gym.physics.mujoco.mjcf import Floor
from aerial_gym.physics.mujoco.trees import MujocoTrees, template

_WRITTEN = ("body_mass", "body_subtreemass", "body_ipos", "body_inertia", "body_iquat", "dof_armature")
"""Arrays of MuJoCo's model with a row for each environment."""


class WarpTrees(MujocoTrees):
    """One model with parameters for each environment, and all environments in one set of launches."""

    backend = "mujoco_warp"

    def __init__(
        self, tree: Tree, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make model and data on the CPU; arguments as for ``RolloutTrees``, but without contact."""
        if floor is not None or cfg is not None:
            raise CapabilityError(f"backend {self.backend}: no contact of a vehicle with joints. Use backend 'mujoco'")
        self._engine, self._mujoco = (load(name, backend=self.backend) for name in ("mujoco_warp", "mujoco"))
        logging.getLogger("mujoco_warp").setLevel(logging.WARNING)
        start_warp()
        first = self._mujoco.MjModel.from_xml_string(template(tree, dt))
        super().__init__(first, tree, num_envs, dt, solids=None, touches=False)
        with wp.ScopedDevice("cpu"):
            self._model = self._engine.put_model(first, dict.fromkeys(_WRITTEN, num_envs))
            self._model.opt.gravity = wp.zeros(num_envs, dtype=wp.vec3)
            self._data = self._engine.make_data(first, nworld=num_envs, nconmax=1, njmax=1)
        self._numbers = {name: wp.to_torch(getattr(self._model, name)) for name in _WRITTEN}
        self._down = wp.to_torch(self._model.opt.gravity)
        held = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat")
        self._given = [wp.to_torch(getattr(self._data, name)) for name in held]
        carried = torch.eye(tree.num_links, dtype=torch.float64)
        for link in range(tree.num_links - 1, 0, -1):
            carried[tree.joints[link - 1].parent] += carried[link]
        self._carried = carried
        """Which links each carries, itself among them, (L, L)."""

    def _write_links(self, changed: list[int], mass: Tensor, com: Tensor, inertia: Tensor, down: Tensor) -> None:
        moments, turns = principal_axes(self._mujoco, inertia)
        subtrees = mass @ self._carried.T
        for name, rows in zip(_WRITTEN, (mass, subtrees, com, moments, turns), strict=False):
            self._numbers[name][torch.tensor(changed)[:, None], self._places] = rows.float()
        self._numbers["body_subtreemass"][changed, 0] = subtrees[:, 0].float()  # of the world
        self._down[changed] = down.float()

    def _write_armature(self, changed: list[int], armature: Tensor) -> None:
        self._numbers["dof_armature"][torch.tensor(changed)[:, None], self._rates] = armature.float()

    def _run(self, start: Tensor, control: Tensor) -> tuple[Tensor, None]:
        rows = torch.cat((start, control), dim=-1).float()
        sizes = [place[0].numel() for place in self._given]
        for place, values in zip(self._given, rows.split(sizes, dim=-1), strict=True):
            place.copy_(values.view_as(place))
        with wp.ScopedDevice("cpu"), on_torch_stream(rows):
            self._engine.step(self._model, self._data)
        return torch.cat(self._given[:2], dim=-1).double(), None
