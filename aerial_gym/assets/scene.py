"""The scene: shapes are shared, transforms are per environment.

A scene holds A instances in each of E environments. An instance is a row of the shape table, a pose and a semantic id.
Poses are strided views of a tensor that belongs to the caller, so moving an obstacle is writing that tensor: nothing is
rebuilt or refitted, and the next ray and the next collision test see it.

An instance may have several parts (branches of a tree, links of a URDF) that move together; each is a shape of its own.
An instance is absent while it is parked: z = ``PARKED_Z``. Whatever lies below ``ABSENT_BELOW`` is skipped with one
comparison.

Beside the instances there may be parts without a row among them: fixed ones, such as the ground, and those of the robot,
which sensors see and which are not touched.

Frames: each environment has its own world frame, z up. Letters: E environments, A instances, P parts of all instances.
"""

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.scene_arrays import BODY, WORLD, SceneArrays
from aerial_gym.assets.shapes import ShapeTable
from aerial_gym.assets.views import check_tensor, vector_view
from aerial_gym.config.environment import LampCfg, PartCfg, ShapeCfg
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.interop import on_torch_stream, start_warp

PARKED_Z = -1000.0
"""Height of an absent instance [m]. Source: Aerial Gym parks its obstacles there (parity 4.8)."""


class Scene:
    """Instances of shared shapes in E environments."""

    def __init__(
        self,
        shapes: Sequence[ShapeCfg],
        *,
        shape_index: Tensor,
        semantic_id: Tensor,
        asset_state: Tensor,
        fixed: Sequence[PartCfg] = (),
        robot: Sequence[PartCfg] = (),
        robot_state: Tensor | None = None,
        lamps: Sequence[LampCfg] = (),
    ) -> None:
        """Read the shapes and take views of the poses.

        Args:
            shapes: The shape table.
            shape_index: Row of the shape table, integer, (E, A), or (A,) if all environments have the same.
            semantic_id: What segmentation shows, integer, (E, A) or (A,).
            asset_state: The caller's poses and velocities, float32, (E, A, 13): position [m], attitude xyzw (shape to
                world, unit), velocity, angular velocity; world. May be strided, but for the last axis. Kept.
            fixed: Parts of the world, in its frame, with semantic ids of their own.
            robot: What is seen of the robot, in its body frame, with semantic ids of their own; it is never touched.
            robot_state: The caller's states of the robot, float32, (E, 13), laid out like those of the instances; needed if
                anything of it is seen. May be strided, but for the last axis. Kept.
            lamps: Lights in colour images, the same in all environments.

        Raises:
            ShapeError: If shapes do not fit, or if an index has no row.
            ConfigError: If a mesh file cannot be used, or a part outside the instances has no semantic id.
        """
        if asset_state.dim() != 3 or asset_state.shape[-1] != 13:
            raise ShapeError(f"asset_state has shape {tuple(asset_state.shape)}, expected (E, A, 13)")
        start_warp()
        self.asset_state, self.lamps = asset_state, tuple(lamps)
        self.num_envs, self.num_instances = asset_state.shape[:2]
        self.device = asset_state.device
        with on_torch_stream(asset_state):
            self.shape_table = ShapeTable([*shapes, *_as_compound((*fixed, *robot))], device=self.device)
        self.shape_index = self._per_instance("shape_index", shape_index)
        self.semantic_id = self._per_instance("semantic_id", semantic_id)
        if self.num_instances and not 0 <= int(self.shape_index.min()) <= int(self.shape_index.max()) < len(shapes):
            raise ShapeError(f"shape_index must lie in 0 to {len(shapes) - 1}, the rows of the shape table")
        self._part_shape, self._part_instance = self._lay_out_parts()
        self._part_semantic = self._semantic_of_parts()
        self._append_parts(num_fixed=len(fixed), num_robot=len(robot))
        self._radius = (
            self.shape_table.radius[self._part_shape.clamp(min=0).long()]
            if len(self.shape_table)
            else torch.zeros(self._part_shape.shape, device=self.device)
        )
        size = (self.num_envs, self.num_instances)
        self.arrays = SceneArrays()
        self.arrays.shapes = self.shape_table.array
        self.arrays.part_shape = wp.from_torch(self._part_shape)
        self.arrays.part_instance = wp.from_torch(self._part_instance)
        self.arrays.semantic_id = wp.from_torch(self._part_semantic)
        self.arrays.num_solid = self.num_parts - len(robot)
        self.arrays.radius = wp.from_torch(self._radius)
        self.arrays.position = vector_view("position", asset_state[..., 0:3], (*size, 3), device=self.device)
        self.arrays.attitude = vector_view("attitude", asset_state[..., 3:7], (*size, 4), device=self.device)
        if robot:
            self._view_robot(robot_state)

    @property
    def num_solid(self) -> int:
        """Number of parts that can be touched, for which an environment has room."""
        return self.arrays.num_solid

    @property
    def num_parts(self) -> int:
        """Number of parts P for which an environment has room."""
        return self._part_shape.shape[1]

    def _lay_out_parts(self) -> tuple[Tensor, Tensor]:
        """Return the row of the shape table (-1 for none) and the instance of every part, int32, each (E, P)."""
        if not self.num_instances:
            nothing = torch.zeros(self.num_envs, 0, dtype=torch.int32, device=self.device)
            return nothing, nothing.clone()
        table, index = self.shape_table, self.shape_index.long()
        end = table.num_parts[index].cumsum(dim=1)  # (E, A): parts of an instance stand side by side
        part = torch.arange(int(end[:, -1].max()), device=self.device).expand(self.num_envs, -1).contiguous()
        instance = torch.searchsorted(end, part, right=True)
        exists, instance = instance < self.num_instances, instance.clamp(max=self.num_instances - 1)
        within = part - (end - table.num_parts[index]).gather(1, instance)
        row = table.first_part[index].gather(1, instance) + within
        return torch.where(exists, row, -1).int(), instance.int()

    def _semantic_of_parts(self) -> Tensor:
        """Return what segmentation shows for every part, int32, (E, P): its own id, or that of its instance."""
        inherited = self.semantic_id.gather(1, self._part_instance.long())
        own = [-1 if part.semantic_id is None else part.semantic_id for part in self.shape_table.parts]
        if not own:
            return inherited
        own_id = torch.tensor(own, dtype=torch.int32, device=self.device)[self._part_shape.clamp(min=0).long()]
        return torch.where(own_id >= 0, own_id, inherited).contiguous()

    def _append_parts(self, *, num_fixed: int, num_robot: int) -> None:
        """Add the parts that belong to no instance: the last ones of the shape table, the same in every environment."""
        count = num_fixed + num_robot
        if not count:
            return
        first, total = len(self.shape_table.parts) - count, len(self.shape_table.parts)
        carrier = [int(WORLD)] * num_fixed + [int(BODY)] * num_robot
        own_id = [part.semantic_id for part in self.shape_table.parts[first:]]
        for name, values in (
            ("_part_shape", list(range(first, total))),
            ("_part_instance", carrier),
            ("_part_semantic", own_id),
        ):
            row = torch.tensor(values, dtype=torch.int32, device=self.device).expand(self.num_envs, -1)
            setattr(self, name, torch.cat((getattr(self, name), row), dim=1).contiguous())

    def _view_robot(self, state: Tensor | None) -> None:
        if state is None:
            raise ShapeError("robot_state: must be given, (E, 13), where the robot has parts that are seen")
        check_tensor("robot_state", state, (self.num_envs, 13), device=self.device)
        self.arrays.body_position = vector_view("robot_state", state[:, 0:3], (self.num_envs, 3), device=self.device)
        self.arrays.body_attitude = vector_view("robot_state", state[:, 3:7], (self.num_envs, 4), device=self.device)

    def _per_instance(self, name: str, values: Tensor) -> Tensor:
        shape = (self.num_envs, self.num_instances)
        if tuple(values.shape) not in (shape, shape[1:]):
            raise ShapeError(f"{name} has shape {tuple(values.shape)}, expected (E, A) = {shape} or (A,) = {shape[1:]}")
        values = values.to(device=self.device, dtype=torch.int32).expand(shape).contiguous()
        check_tensor(name, values, shape, device=self.device, dtype=torch.int32)
        return values


def _as_compound(parts: tuple[PartCfg, ...]) -> list[ShapeCfg]:
    """Return parts that belong to no instance as one more row for the shape table; none without parts."""
    for part in parts:
        if part.semantic_id is None:
            raise ConfigError(f"{part.shape.kind} outside the instances: needs a semantic_id of its own")
    return [ShapeCfg(kind="compound", parts=parts)] if parts else []
