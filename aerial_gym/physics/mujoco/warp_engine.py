"""MuJoCo Warp in float32: free bodies, and trees of links without contacts, as one model with parameters per environment.

Letters: E environments, N rows of parameters (1 if all environments share them, else E), C spheres, L links, D joints.
"""

import logging

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.interop import on_torch_stream, start_warp
from aerial_gym.physics.articulated.tree import Tree
from aerial_gym.physics.mujoco.bodies import (
    COM,
    GRAVITY,
    INERTIA,
    MASS,
    Bodies,
    compile_template_body,
    import_optional,
    principal_axes,
)
from aerial_gym.physics.mujoco.mjcf import Floor
from aerial_gym.physics.mujoco.trees import MujocoTrees, template_mjcf

_BODY_ARRAYS = ("body_mass", "body_subtreemass", "body_inertia", "body_iquat", "body_invweight0", "geom_pos")
"""Arrays of MuJoCo's model that are written."""

_mass, _com, _gravity = wp.constant(MASS), wp.constant(COM.start), wp.constant(GRAVITY)
_inertia = wp.constant(INERTIA.start)


@wp.kernel(enable_backward=False)
def _write_rows(
    # params
    rows: wp.array2d[float],  # (N, 14) of ``body_rows``
    spheres: wp.array[wp.vec3],  # (C,) centres, body frame of the robot file [m]
    # out
    mass_out: wp.array2d[float],  # (N, 2) [kg], of the world and of the body, as the others
    subtree_mass_out: wp.array2d[float],  # (N, 2) [kg]
    moments_out: wp.array2d[wp.vec3],  # (N, 2) [kg m²]
    axes_out: wp.array2d[wp.quat],  # (N, 2) principal axes to body, wxyz
    mobility_out: wp.array2d[wp.vec2],  # (N, 2) mean [1/kg] and [1/(kg m²)]
    geom_pos_out: wp.array2d[wp.vec3],  # (N, 1 + C) [m], the floor first
    gravity_out: wp.array[wp.vec3],  # (N,) [m/s²]
):
    """Write mass, principal moments and axes, the mobility for contacts, positions of spheres, and gravity."""
    n = wp.tid()
    mass = rows[n, _mass]
    inertia = wp.mat33()
    for i in range(3):
        for j in range(3):
            inertia[i, j] = rows[n, _inertia + 3 * i + j]
    size = wp.trace(inertia)
    axes, moments = wp.eig3(inertia / size)
    if wp.determinant(axes) < 0.0:
        axes = -axes
    turn = wp.quat_from_matrix(axes)
    moments = size * moments
    mass_out[n, 1] = mass
    subtree_mass_out[n, 0] = mass
    subtree_mass_out[n, 1] = mass
    moments_out[n, 1] = moments
    axes_out[n, 1] = wp.quat(turn[3], turn[0], turn[1], turn[2])
    mobility_out[n, 1] = wp.vec2(1.0 / mass, (1.0 / moments[0] + 1.0 / moments[1] + 1.0 / moments[2]) / 3.0)
    gravity_out[n] = wp.vec3(0.0, 0.0, -rows[n, _gravity])
    com = wp.vec3(rows[n, _com], rows[n, _com + 1], rows[n, _com + 2])
    for k in range(spheres.shape[0]):
        geom_pos_out[n, 1 + k] = spheres[k] - com


class WarpBodies(Bodies):
    """One model with parameters for each row, and all environments in one set of launches."""

    def __init__(
        self, rows: Tensor, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make model and data on the device of ``rows``; other arguments as for ``RolloutBodies``."""
        self._engine = import_optional("mujoco_warp", backend="mujoco_warp")
        mujoco = import_optional("mujoco", backend="mujoco_warp")
        logging.getLogger("mujoco_warp").setLevel(logging.WARNING)
        start_warp()
        self.dt, self.num_rows, self._device = dt, len(rows), rows.device
        template = compile_template_body(mujoco, floor, cfg, dt)
        spheres = [] if floor is None else [list(sphere[:3]) for sphere in floor.spheres]
        contacts = max(1, len(spheres))
        with wp.ScopedDevice(wp.device_from_torch(rows.device)):
            self._model = self._engine.put_model(template, dict.fromkeys(_BODY_ARRAYS, len(rows)))
            self._model.opt.gravity = wp.zeros(len(rows), dtype=wp.vec3)
            self._data = self._engine.make_data(template, nworld=num_envs, nconmax=contacts, njmax=3 * contacts)
            self._spheres = wp.array(spheres, dtype=wp.vec3)
        self._pose, self._twist = wp.to_torch(self._data.qpos), wp.to_torch(self._data.qvel)
        self._push = wp.to_torch(self._data.xfrc_applied)[:, 1]
        self.set_parameters(rows)

    def set_parameters(self, rows: Tensor) -> None:
        """Write the parameters (N, 14) into the model."""
        rows = rows.float().contiguous()
        with on_torch_stream(rows):
            wp.launch(
                _write_rows,
                dim=len(rows),
                inputs=[wp.from_torch(rows), self._spheres],
                outputs=[*(getattr(self._model, name) for name in _BODY_ARRAYS), self._model.opt.gravity],
                device=self._spheres.device,
            )

    def _inputs(self) -> tuple[Tensor, Tensor, Tensor]:
        return self._pose, self._twist, self._push

    def _step(self) -> None:
        with wp.ScopedDevice(self._spheres.device), on_torch_stream(self._pose):
            self._engine.step(self._model, self._data)

    def _outputs(self) -> tuple[Tensor, Tensor]:
        return self._pose, self._twist


_TREE_ARRAYS = ("body_mass", "body_subtreemass", "body_ipos", "body_inertia", "body_iquat", "dof_armature")
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
        self._engine, self._mujoco = (import_optional(name, backend=self.backend) for name in ("mujoco_warp", "mujoco"))
        logging.getLogger("mujoco_warp").setLevel(logging.WARNING)
        start_warp()
        first = self._mujoco.MjModel.from_xml_string(template_mjcf(tree, dt))
        super().__init__(first, tree, num_envs, dt, solids=None, touches=False)
        with wp.ScopedDevice("cpu"):
            self._model = self._engine.put_model(first, dict.fromkeys(_TREE_ARRAYS, num_envs))
            self._model.opt.gravity = wp.zeros(num_envs, dtype=wp.vec3)
            self._data = self._engine.make_data(first, nworld=num_envs, nconmax=1, njmax=1)
        self._numbers = {name: wp.to_torch(getattr(self._model, name)) for name in _TREE_ARRAYS}
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
        for name, rows in zip(_TREE_ARRAYS, (mass, subtrees, com, moments, turns), strict=False):
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
