"""The scene: shapes are shared, transforms are per environment.

A scene holds A instances in each of E environments. An instance is a row of the shape table, a pose and a semantic id.
Poses are strided views of the caller's tensor. To move an obstacle, write that tensor; the next ray and the next collision
test use it without a rebuild.

An instance may have several parts (branches of a tree, links of a URDF) that move together; each is a shape of its own.
An absent instance is parked at z = ``PARKED_Z``. Kernels skip all instances below ``ABSENT_BELOW``.

Further parts belong to no instance: fixed ones, such as the ground, and those of the vehicles, which sensors see but collisions
ignore.

Frames: each environment has its own world frame, z up. Letters: E environments, A instances, P parts of all instances,
L links of all visible vehicles of an environment.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.scene_arrays import BODY, WORLD, SceneArrays, check_tensor, vector_view
from aerial_gym.assets.shapes import ShapeTable
from aerial_gym.config.environment import FIRST_INSTANCE_ID, LampCfg, PartCfg, ShapeCfg
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.interop import make_struct, on_torch_stream, start_warp

PARKED_Z = -1000.0  # Height of an absent instance [m]. Source: Aerial Gym parks its obstacles there (parity 4.8)


@dataclass(frozen=True, kw_only=True)
class VisibleVehicle:
    """One vehicle of every environment, as sensors see it."""

    parts: tuple[PartCfg, ...]  # Shapes in the frames of its links; without a semantic id they show the vehicle's own
    links: tuple[str, ...] = (BASE,)  # Names of its links, the base first


class Scene:
    """Instances of shared shapes in E environments."""

    def __init__(
        self, shapes: Sequence[ShapeCfg], *, shape_index: Tensor, semantic_id: Tensor, asset_state: Tensor,
        groups: Sequence[tuple[int, int]] | None = None, fixed: Sequence[PartCfg] = (),
        vehicles: Sequence[VisibleVehicle] = (), link_state: Tensor | None = None, lamps: Sequence[LampCfg] = (),
    ) -> None:  # fmt: skip
        """Read the shapes and take views of the poses.

        Args:
            shape_index: Row of the shape table, integer, (E, A), or (A,) if all environments have the same.
            semantic_id: Label in segmentation images, integer, (E, A) or (A,).
            asset_state: The caller's poses and velocities, float32, (E, A, 13): position [m], attitude xyzw (shape to
                world, unit), velocity, angular velocity; world. May be strided, but for the last axis. Kept.
            groups: Pairs (number of instances, number of shapes) of consecutive shapes among which ``relabel`` may exchange;
                without groups, instances keep their shapes.
            fixed: Parts of the world, in its frame, with semantic ids of their own.
            vehicles: The vehicles of each environment, ignored by collisions. Vehicle v has the id of an instance in row A + v.
            link_state: The caller's states of their links, vehicle by vehicle, float32, (E, L, 13), laid out like those of the
                instances; (E, 13) of one link. Needed for visible parts. May be strided, but for the last axis. Kept.
            lamps: Lights in colour images, the same in all environments.
        """
        if asset_state.dim() != 3 or asset_state.shape[-1] != 13:
            raise ShapeError(f"asset_state has shape {tuple(asset_state.shape)}, expected (E, A, 13)")
        start_warp()
        seen = [(number, part) for number, each in enumerate(vehicles) for part in each.parts]
        self.asset_state, self.lamps = asset_state, tuple(lamps)
        self.num_envs, self.num_instances = asset_state.shape[:2]
        self.device = asset_state.device
        with on_torch_stream(asset_state):
            compound = _compound_of_parts((*fixed, *(part for _, part in seen)))
            self.shape_table = ShapeTable([*shapes, *compound], device=self.device)
        self._num_shapes = len(shapes)
        solid = self.shape_table.parts[: len(self.shape_table.parts) - len(seen)]
        self.has_meshes = any(part.shape.kind == "mesh" for part in solid)
        """Whether a part that can be touched is a mesh."""
        size = (self.num_envs, self.num_instances)
        self.shape_index = torch.zeros(size, dtype=torch.int32, device=self.device)
        self.semantic_id = torch.zeros(size, dtype=torch.int32, device=self.device)
        self._set_instances(shape_index, semantic_id)
        first_link = list(accumulate((len(each.links) for each in vehicles), initial=0))
        carriers = [int(WORLD)] * len(fixed)
        carriers += [int(BODY) - first_link[v] - _link_index(part, vehicles[v].links) for v, part in seen]
        own_id = FIRST_INSTANCE_ID + self.num_instances  # of the first vehicle
        ids = [_require_id(part) for part in fixed]
        ids += [own_id + v if part.semantic_id is None else part.semantic_id for v, part in seen]
        self._allocate_parts(self._max_num_parts(groups), carriers, ids)
        self._lay_out_parts()
        self.arrays = make_struct(
            SceneArrays, shapes=self.shape_table.array, part_shape=self._part_shape,
            part_instance=self._part_instance, semantic_id=self._part_semantic, num_solid=self.num_parts - len(seen),
            radius=self._radius,
            position=vector_view("position", asset_state[..., 0:3], (*size, 3), device=self.device),
            attitude=vector_view("attitude", asset_state[..., 3:7], (*size, 4), device=self.device),
        )  # fmt: skip
        self.link_state: Tensor | None = None
        """States of the vehicles' links, (E, L, 13); None where no vehicle is seen."""
        if seen:
            self._view_links(link_state, first_link)

    @property
    def num_solid(self) -> int:
        """Capacity for solid parts of an environment."""
        return self.arrays.num_solid

    @property
    def num_parts(self) -> int:
        """Capacity P for parts of an environment."""
        return self._part_shape.shape[1]

    def instance_parts(self) -> tuple[tuple[PartCfg, ...], Tensor, Tensor]:
        """Return all parts of instances, and views (E, P) of the row of each (-1 for an empty slot) and of its instance."""
        slots = slice(self._num_carried)
        return self.shape_table.parts[: self._num_rows], self._part_shape[:, slots], self._part_instance[:, slots]

    def relabel(self, shape_index: Tensor, semantic_id: Tensor) -> None:
        """Change shape rows and semantic ids of instances, integer (E, A), within their groups. Waits for the device."""
        self._set_instances(shape_index, semantic_id)
        self._lay_out_parts()

    def _set_instances(self, shape_index: Tensor, semantic_id: Tensor) -> None:
        self.shape_index.copy_(self._parts_to_instances("shape_index", shape_index))
        self.semantic_id.copy_(self._parts_to_instances("semantic_id", semantic_id))
        rows = self.shape_index
        if self.num_instances and not 0 <= int(rows.min()) <= int(rows.max()) < self._num_shapes:
            raise ShapeError(f"shape_index must lie in 0 to {self._num_shapes - 1}, the rows of the shape table")

    def _max_num_parts(self, groups: Sequence[tuple[int, int]] | None) -> int:
        """Return the largest possible number of instance parts in an environment."""
        if not self.num_instances:
            return 0
        if groups is None:
            return int(self.shape_table.num_parts[self.shape_index.long()].sum(dim=1).max())
        most, first = 0, 0
        for count, num_shapes in groups:
            most += count * int(self.shape_table.num_parts[first : first + num_shapes].max())
            first += num_shapes
        return most

    @property
    def num_links(self) -> int:
        """Number L of links of visible vehicles, 0 without any."""
        return 0 if self.link_state is None else self.link_state.shape[1]

    def _allocate_parts(self, num_parts: int, carriers: Sequence[int], ids: Sequence[int]) -> None:
        """Allocate the arrays of parts; parts without instance have the last slots and the last rows of the shape table."""
        first, total = len(self.shape_table.parts) - len(carriers), len(self.shape_table.parts)
        size = (self.num_envs, num_parts + total - first)
        self._num_carried, self._num_rows = num_parts, first
        self._part_shape, self._part_instance, self._part_semantic = (
            torch.zeros(size, dtype=torch.int32, device=self.device) for _ in range(3)
        )
        self._radius = torch.zeros(size, device=self.device)
        for rows, values in (
            (self._part_shape, list(range(first, total))),
            (self._part_instance, list(carriers)),
            (self._part_semantic, list(ids)),
        ):
            rows[:, num_parts:] = torch.tensor(values, dtype=torch.int32, device=self.device)

    def _lay_out_parts(self) -> None:
        """Write shape row (-1 for none), instance, semantic id and radius of every instance part."""
        if self.num_instances:
            table, index = self.shape_table, self.shape_index.long()
            end = table.num_parts[index].cumsum(dim=1)  # (E, A): parts of an instance stand side by side
            if int(end[:, -1].max()) > self._num_carried:
                raise ShapeError(f"shape_index: {int(end[:, -1].max())} parts, there is room for {self._num_carried}")
            part = torch.arange(self._num_carried, device=self.device).expand(self.num_envs, -1).contiguous()
            instance = torch.searchsorted(end, part, right=True)
            exists, instance = instance < self.num_instances, instance.clamp(max=self.num_instances - 1)
            within = part - (end - table.num_parts[index]).gather(1, instance)
            row = table.first_part[index].gather(1, instance) + within
            own = [-1 if part.semantic_id is None else part.semantic_id for part in table.parts]
            own_id = torch.tensor(own, dtype=torch.int32, device=self.device)[torch.where(exists, row, 0)]
            carried = slice(self._num_carried)
            self._part_shape[:, carried] = torch.where(exists, row, -1).int()
            self._part_instance[:, carried] = instance.int()
            self._part_semantic[:, carried] = torch.where(own_id >= 0, own_id, self.semantic_id.gather(1, instance))
        if len(self.shape_table):
            self._radius.copy_(self.shape_table.radius[self._part_shape.clamp(min=0).long()])

    def _view_links(self, state: Tensor | None, first_link: Sequence[int]) -> None:
        if state is None:
            raise ShapeError("link_state: (E, L, 13) is needed for the visible parts of vehicles")
        state = state.unsqueeze(1) if state.dim() == 2 else state
        size, device = (self.num_envs, first_link[-1]), self.device
        check_tensor("link_state", state, (*size, 13), device=device)
        self.arrays.link_position = vector_view("link_state", state[..., 0:3], (*size, 3), device=device)
        self.arrays.link_attitude = vector_view("link_state", state[..., 3:7], (*size, 4), device=device)
        is_base = [link in first_link for link in range(size[1])]
        self.arrays.link_is_base = wp.array(is_base, dtype=wp.bool, device=wp.device_from_torch(device))
        self.link_state = state

    def _parts_to_instances(self, name: str, values: Tensor) -> Tensor:
        shape = (self.num_envs, self.num_instances)
        if tuple(values.shape) not in (shape, shape[1:]):
            raise ShapeError(f"{name} has shape {tuple(values.shape)}, expected (E, A) = {shape} or (A,) = {shape[1:]}")
        values = values.to(device=self.device, dtype=torch.int32).expand(shape).contiguous()
        check_tensor(name, values, shape, device=self.device, dtype=torch.int32)
        return values


def _link_index(part: PartCfg, names: Sequence[str]) -> int:
    """Return the number of the link that carries a part."""
    if part.link not in names:
        raise ConfigError(f"{part.shape.kind} on link {part.link!r}: the robot has the links {', '.join(names)}")
    return names.index(part.link)


def _require_id(part: PartCfg) -> int:
    """Return the semantic id of a fixed part."""
    if part.semantic_id is None:
        raise ConfigError(f"{part.shape.kind} outside the instances: needs a semantic_id of its own")
    return part.semantic_id


def _compound_of_parts(parts: tuple[PartCfg, ...]) -> list[ShapeCfg]:
    """Return parts without instance as one compound for the shape table; none without parts."""
    return [ShapeCfg(kind="compound", parts=tuple(replace(part, link=BASE) for part in parts))] if parts else []
