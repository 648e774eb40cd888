"""Collisions between the vehicles of an environment: distance of their shapes, and contacts during a step.

Every pair of shapes of two vehicles is measured and swept as in the collision test with obstacles. A ball about each body
origin that holds all shapes excludes most pairs. A thread sweeps a pair, for both of its vehicles. The distance of a vehicle
takes a thread of its own. It measures the others by rising distance of their balls, until the next ball is farther than the
nearest shape.
Frames: shapes in the body frame, poses in the environment's world frame. Letters: E environments, T vehicles of an environment
over all kinds (*slots*), P pairs of them, N = E T rows over all kinds, C shapes, K substeps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.body_shapes import BodyShape, body_shapes, shape_gap
from aerial_gym.assets.cores import body_reach
from aerial_gym.assets.scene_arrays import Shape, vector_view
from aerial_gym.assets.shapes import ShapeTable
from aerial_gym.assets.sweep import NEAR, make_path, make_touches
from aerial_gym.config.robot import CollisionCfg
from aerial_gym.config.shape import BASE, ShapeCfg
from aerial_gym.interop import ReusableLaunch, make_struct, start_warp

_touches = make_touches(cores=True, meshes=False)


@wp.struct
class Slot:
    """One vehicle of every environment: its rows and shapes."""

    first_row: wp.int32  # of environment 0
    row_step: wp.int32  # from an environment to the next
    first_shape: wp.int32
    end_shape: wp.int32
    hull: wp.float32  # radius of a ball about the body origin that holds all shapes [m]


@dataclass(frozen=True, kw_only=True)
class SlotTable:
    """The vehicles of an environment, kind by kind, and their collision shapes."""

    collisions: Sequence[CollisionCfg]  # Of each kind
    counts: Sequence[int]  # Vehicles of each kind in an environment
    num_envs: int

    @property
    def hulls(self) -> list[float]:
        """Radius about the body origin of the collision shapes of each kind [m]."""
        return [body_reach(cfg.link_shapes(BASE)) for cfg in self.collisions]

    def first_slot(self, kind: int) -> int:
        """Return the slot of a kind's first vehicle."""
        return sum(self.counts[:kind])

    def rows(self, kind: int) -> slice:
        """Return the rows of a kind among N."""
        first = self.num_envs * self.first_slot(kind)
        return slice(first, first + self.num_envs * self.counts[kind])

    def array(self, device: torch.device) -> wp.array:
        """Return the slots for a kernel, (T,) of ``Slot``."""
        start_warp()
        slots, shape = [], 0
        for kind, (cfg, count, hull) in enumerate(zip(self.collisions, self.counts, self.hulls, strict=True)):
            end = shape + len(cfg.link_shapes(BASE))
            given = {"row_step": count, "first_shape": shape, "end_shape": end, "hull": hull}
            slots += [make_struct(Slot, first_row=self.rows(kind).start + v, **given) for v in range(count)]
            shape = end
        return wp.array(slots, dtype=Slot, device=wp.device_from_torch(device))

    def pairs(self, device: torch.device) -> wp.array:
        """Return the slots of each pair of vehicles with shapes, the lower first, (P,)."""
        hulls = [hull for hull, count in zip(self.hulls, self.counts, strict=True) for _ in range(count)]
        solid = [slot for slot, hull in enumerate(hulls) if hull > 0.0]
        pairs = [wp.vec2i(*pair) for pair in combinations(solid, 2)]
        return wp.array(pairs, dtype=wp.vec2i, device=wp.device_from_torch(device))


@wp.func
def _hulls_meet(reach: float, before: wp.vec3, after: wp.vec3) -> wp.bool:
    """Return whether two balls come within the sum of their radii, ``reach``; offsets of their centres at both ends."""
    shift = after - before
    t = wp.clamp(-wp.dot(before, shift) / wp.max(wp.dot(shift, shift), 1.0e-20), 0.0, 1.0)
    return wp.length(before + t * shift) < reach + NEAR


@wp.kernel(enable_backward=False)
def _measure_vehicles(
    # params
    shapes: wp.array[Shape],  # (C,)
    body: wp.array[BodyShape],  # (C,) the same
    slots: wp.array[Slot],  # (T,)
    # state
    position: wp.array2d[wp.vec3],  # (K, N) world [m]; the last row counts
    attitude: wp.array2d[wp.quat],  # (K, N) body to world, xyzw
    is_step: wp.bool,  # whether contacts are crashes
    # out
    distance_out: wp.array[float],  # (N,) [m]
    crashes_out: wp.array[wp.bool],  # (N,) set at a contact
    touches_out: wp.array[wp.bool],  # (N,) whether there is one; written in a step
):
    """Write the distance of each vehicle to the nearest other one, or inf without any."""
    env, i = wp.tid()
    own = slots[i]
    a = own.first_row + env * own.row_step
    last = position.shape[0] - 1
    x = position[last, a]
    distance = float(wp.inf)
    bound = float(-wp.inf)  # of the gap of the present other vehicle
    j = wp.int32(-1)
    for _ in range(slots.shape[0]):
        least = distance
        following = wp.int32(-1)
        for k in range(slots.shape[0]):
            if k != i and own.hull > 0.0 and slots[k].hull > 0.0:
                apart = wp.length(position[last, slots[k].first_row + env * slots[k].row_step] - x)
                apart -= own.hull + slots[k].hull
                if apart < least and (apart > bound or (apart == bound and k > j)):
                    least = apart
                    following = k
        if following < 0:
            break
        bound = least
        j = following
        one = slots[wp.min(i, j)]  # in one order, so that both vehicles get the same number
        other = slots[wp.max(i, j)]
        b = one.first_row + env * one.row_step
        c = other.first_row + env * other.row_step
        q = attitude[last, b]
        gap = float(wp.inf)
        for m in range(one.first_shape, one.end_shape):
            shape = shapes[m]
            origin = position[last, b] + wp.quat_rotate(q, shape.position)
            for n in range(other.first_shape, other.end_shape):
                gap = shape_gap(shape, origin, q * shape.attitude, body[n], position[last, c], attitude[last, c], gap)
        distance = wp.min(distance, gap)
    distance_out[a] = distance
    if is_step:
        touches_out[a] = distance < 0.0
        crashes_out[a] = crashes_out[a] or distance < 0.0


@wp.kernel(enable_backward=False)
def _sweep_pairs(
    # params
    shapes: wp.array[Shape],  # (C,)
    body: wp.array[BodyShape],  # (C,) the same
    slots: wp.array[Slot],  # (T,)
    pairs: wp.array[wp.vec2i],  # (P,) slots of each pair, the lower first
    # state
    position: wp.array2d[wp.vec3],  # (K + 1, N) at the start of a step and after each substep, world [m]
    attitude: wp.array2d[wp.quat],  # (K + 1, N) body to world, xyzw
    # out
    crashes_out: wp.array[wp.bool],  # (N,) set at a contact at or between the poses
    touches_out: wp.array[wp.bool],  # (N,) the same
):
    """Set the flags of both vehicles that touch within a step."""
    env, p = wp.tid()
    one = slots[pairs[p][0]]
    other = slots[pairs[p][1]]
    a = one.first_row + env * one.row_step
    b = other.first_row + env * other.row_step
    x = position[0, a]
    y = position[0, b]
    for k in range(position.shape[0] - 1):
        end_x = position[k + 1, a]
        end_y = position[k + 1, b]
        if _hulls_meet(one.hull + other.hull, y - x, end_y - end_x):
            path = make_path(wp.vec3(), x, attitude[k, a], end_x, attitude[k + 1, a])
            other_path = make_path(wp.vec3(), y, attitude[k, b], end_y, attitude[k + 1, b])
            touches = wp.bool(False)
            for m in range(one.first_shape, one.end_shape):
                for n in range(other.first_shape, other.end_shape):
                    if not touches:
                        touches = _touches(shapes[m], path, body[n], other_path, 0.0, 1.0)
            if touches:
                crashes_out[a] = True
                crashes_out[b] = True
                touches_out[a] = True
                touches_out[b] = True
                return
        x = end_x
        y = end_y


class VehicleCollisionTest:
    """Distances between the vehicles of each environment, and their contacts; all views are made at construction."""

    def __init__(
        self, slots: SlotTable, *, states: Tensor, position: Tensor, attitude: Tensor, distances_out: Tensor,
        crashes_out: Tensor, touches_out: Tensor,
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are.

        Args:
            states: Position [m] and attitude, xyzw, of all vehicles first, world, (N, 13).
            position: Body origins at the start of a step and after each substep [m], world, (K + 1, N, 3).
            attitude: Body to world, xyzw, unit, (K + 1, N, 4).
            distances_out: Least distance to another vehicle [m], float32, (N,); inf without any.
            crashes_out: Set at a contact, bool, (N,); never cleared here.
            touches_out: Whether there was a contact in the last step, bool, (N,).
        """
        device, self._distances = states.device, distances_out
        parts = tuple(
            replace(part, link=BASE) for cfg in slots.collisions for part in cfg.parts if part.link == BASE
        )  # the shapes as parts, in the same order
        shapes = [shape for cfg in slots.collisions for shape in cfg.link_shapes(BASE)]
        self._table = ShapeTable([ShapeCfg(kind="compound", parts=parts)] if parts else [], device=device)
        fixed = [self._table.array, body_shapes(shapes, device=device), slots.array(device)]
        now = (states[:, :3].unsqueeze(0), states[:, 3:7].unsqueeze(0))

        def views(poses: tuple[Tensor, Tensor]) -> list[wp.array]:
            return [vector_view("pose", each, tuple(each.shape), device=device) for each in poses]

        self._now, self._end = (
            ReusableLaunch(
                _measure_vehicles, dim=(slots.num_envs, len(fixed[-1])), inputs=[*fixed, *views(poses), is_step],
                outputs=[distances_out, crashes_out, touches_out], device=device,
            )
            for poses, is_step in ((now, False), ((position, attitude), True))
        )  # fmt: skip
        pairs = slots.pairs(device)
        self._sweep = ReusableLaunch(
            _sweep_pairs, dim=(slots.num_envs, len(pairs)), inputs=[*fixed, pairs, *views((position, attitude))],
            outputs=[crashes_out, touches_out], device=device,
        ) if len(pairs) else None  # fmt: skip

    def measure(self) -> None:
        """Write the distances of the present poses."""
        self._now.launch(self._distances)

    def step(self) -> None:
        """Set crashes of the step that has just been flown, and write the distances at its end."""
        self._end.launch(self._distances)  # writes the flags that the sweep sets
        if self._sweep is not None:
            self._sweep.launch(self._distances)
