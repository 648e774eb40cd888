"""The collision test: how far the robot's shapes are from the scene, now or at each substep of a step.

Shapes on links of a robot that bends are measured link by link, each with the poses of its own frame.

All substeps are one launch. A block of threads takes an environment and each of its threads some of the parts, which it
follows through the substeps: moves the instance that carries it, looks for a touch at every pose of the robot, and measures
the distance at the last one. On the CPU a block is one thread, which keeps the nearest distance so far and passes over what
is farther.

A part at rest is looked at from the last pose first. Signed distance changes by no more than the point moves, so a part
that is farther from a sphere than the sphere went in the step touches it in no substep. Of a mesh, whose sign is found by a
winding number, only the bounding sphere is used. Robots of spheres alone have a kernel without boxes and capsules.
Frames: centres of shapes in the body frame, poses in the environment's world frame. Letters: E environments, A instances,
P parts of all instances, C shapes, K substeps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import inf
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.body_shapes import (
    BodyShape,
    body_distance,
    body_reach,
    body_reach_in_step,
    body_shapes,
    contact_points,
    has_cores,
)
from aerial_gym.assets.geometry import MESH, Shape, signed_distance
from aerial_gym.assets.motion import instance_moves, move_instance, moved
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, WORLD, SceneArrays
from aerial_gym.assets.views import check_tensor, vector_view
from aerial_gym.config.robot import CollisionShape
from aerial_gym.errors import ShapeError
from aerial_gym.interop import RecordedLaunch, launch_side_by_side, on_torch_stream, split

BLOCK_DIM = 64
"""Threads that share an environment on a GPU."""

MIN_PARTS_PER_THREAD = 8192
"""Parts of environments below which another CPU thread costs more than it saves (a hand-over takes some 50 µs)."""

MARGIN = wp.constant(1.0e-3)
"""Room for float32 rounding [m] when a part is passed over for being farther than the robot went: places up to 1 km from the
origin are rounded by 6e-5 m."""

_ROUNDING = 1.0 + 1e-5
"""Bounding spheres are larger by this factor, as in the shape table."""


@wp.struct
class NoObstacles:
    """In the place of obstacles that move where there are none: a launch costs the more the longer its arguments are."""

    nothing: int


@wp.func
def _sphere_center(sphere: wp.vec4, position: wp.vec3, attitude: wp.quat) -> wp.vec3:
    return position + wp.quat_rotate(attitude, wp.vec3(sphere[0], sphere[1], sphere[2]))


@wp.func
def _gap(
    shape: Shape,
    origin: wp.vec3,
    turn: wp.quat,
    sphere: wp.array[wp.vec4],
    position: wp.vec3,
    attitude: wp.quat,
    limit: float,
) -> float:
    """Return the least signed distance of the robot's spheres to a part [m], or ``limit`` if that is smaller."""
    nearest = float(limit)
    for c in range(sphere.shape[0]):
        radius = sphere[c][3]
        offset = _sphere_center(sphere[c], position, attitude) - origin
        if wp.length(offset) - shape.radius - radius < nearest:
            nearest = wp.min(nearest, signed_distance(shape, wp.quat_rotate_inv(turn, offset)) - radius)
    return nearest


@wp.func
def _reach(
    sphere: wp.array[wp.vec4], position: wp.array2d[wp.vec3], attitude: wp.array2d[wp.quat], env: int, last: int
) -> float:
    """Return how far the centre of a sphere is from its last place [m], at most, after any substep."""
    reach = float(wp.static(0.0))
    for c in range(sphere.shape[0]):
        end = _sphere_center(sphere[c], position[last, env], attitude[last, env])
        for k in range(last):
            reach = wp.max(reach, wp.length(_sphere_center(sphere[c], position[k, env], attitude[k, env]) - end))
    return reach


@cache
def make_walk(*, moves: bool, shared: bool, cores: bool) -> wp.Kernel:
    """Return the kernel of the collision test.

    Args:
        moves: Whether obstacles move.
        shared: Whether a block of threads shares an environment, rather than one thread taking all of it; only on a GPU: on
            the CPU Warp's reductions over a block may not run on two threads of the process at once.
        cores: Whether the robot has boxes or capsules, and its shapes are ``BodyShape`` instead of centre and radius.
    """
    body_type = wp.array[BodyShape] if cores else wp.array[wp.vec4]
    gap_of, reach_of = (body_distance, body_reach_in_step) if cores else (_gap, _reach)
    obstacles_type: Any = Obstacles if moves else NoObstacles

    @wp.kernel(module="unique", enable_backward=False)
    def walk(
        # scene
        scene: SceneArrays,
        # state
        position: wp.array2d[wp.vec3],  # (K, E) after each substep, world [m]
        attitude: wp.array2d[wp.quat],  # (K, E) body to world, xyzw
        # params
        body: body_type,  # (C,) centre in the body frame, radius [m], or more
        hull: float,  # radius of a ball about the body origin that holds all shapes [m]
        dt: float,  # [s] of a substep
        is_step: wp.bool,  # whether obstacles move before each pose, and touches are crashes
        joins: wp.bool,  # whether another link was measured before this one
        is_last: wp.bool,  # whether none comes after it
        first: int,  # environment of the first block
        # out
        obstacles_out: obstacles_type,
        distance_out: wp.array[float],  # (E,) [m]
        crashes_out: wp.array[wp.bool],  # (E,) set where something is touched at one of the poses
    ):
        """Write the least signed distance between a shape and a part at the last pose, inf if there is none."""
        block, lane = wp.tid()
        env = block + first
        last = position.shape[0] - 1
        nearest = float(wp.inf)
        touches = wp.bool(False)
        reach = reach_of(body, position, attitude, env, last)
        for part in range(lane, scene.num_solid, wp.block_dim()):
            row = scene.part_shape[env, part]
            a = scene.part_instance[env, part]
            x = wp.vec3()
            q = wp.quat_identity()
            goes = wp.bool(False)
            if row >= 0 and a != WORLD:
                x = scene.position[env, a]
                q = scene.attitude[env, a]
                if wp.static(moves):
                    goes = is_step and instance_moves(obstacles_out, env, a)
            if row >= 0 and x[2] > ABSENT_BELOW:
                if wp.static(moves):  # noqa: SIM102 (only what stands alone is static)
                    if goes:
                        v = obstacles_out.lin_vel[env, a]
                        for k in range(last + 1):
                            x, q, v = moved(obstacles_out, env, a, x, q, v, dt)
                            p = position[k, env]
                            limit = wp.where(k < last, 0.0, nearest)
                            origin = x + wp.quat_rotate(q, scene.shapes[row].position)
                            if wp.length(p - origin) - scene.radius[env, part] - hull < limit:
                                shape = scene.shapes[row]
                                gap = gap_of(shape, origin, q * shape.attitude, body, p, attitude[k, env], limit)
                                touches = touches or gap < 0.0
                                if k == last:
                                    nearest = wp.min(nearest, gap)
                if not goes:
                    p = position[last, env]
                    gap = wp.max(nearest, reach + MARGIN)
                    origin = x + wp.quat_rotate(q, scene.shapes[row].position)
                    if wp.length(p - origin) - scene.radius[env, part] - hull < gap:
                        shape = scene.shapes[row]
                        gap = gap_of(shape, origin, q * shape.attitude, body, p, attitude[last, env], gap)
                        nearest = wp.min(nearest, gap)
                        touches = touches or gap < 0.0
                    if last > 0 and (gap < reach + MARGIN or scene.shapes[row].kind == MESH):
                        for k in range(last):
                            p = position[k, env]
                            if wp.length(p - origin) - scene.radius[env, part] - hull < 0.0:
                                shape = scene.shapes[row]
                                at = gap_of(shape, origin, q * shape.attitude, body, p, attitude[k, env], 0.0)
                                touches = touches or at < 0.0
        if touches and is_step:
            crashes_out[env] = True
        least = nearest
        if wp.static(shared):
            least = wp.tile_min(wp.tile(nearest))[0]  # waits for all threads of the block: none reads a pose after it
        if lane == 0:
            if joins:
                least = wp.min(least, distance_out[env])
            distance_out[env] = least
        if wp.static(moves):  # noqa: SIM102 (only what stands alone is static)
            if is_step and is_last:
                for a in range(lane, obstacles_out.asset.shape[1], wp.block_dim()):
                    move_instance(obstacles_out, env, a, dt, last + 1)

    return walk


@dataclass(frozen=True, kw_only=True)
class LinkShapes:
    """Collision shapes on a link, and where that is."""

    shapes: Sequence[CollisionShape]
    """In the frame of the link."""

    number: int = 0
    """Of the link; 0 of the body."""

    position: Tensor
    """Origin of the frame [m], world, (E, 3); may be strided, but for the last axis."""

    attitude: Tensor
    """To the world, xyzw, unit, (E, 4); likewise."""


class _Body:
    """The shapes of a link as a kernel takes them."""

    def __init__(self, link: LinkShapes, *, device: torch.device) -> None:
        self.link, self.cores, self.hull = link, has_cores(link.shapes), _ROUNDING * body_reach(link.shapes)
        self._points = contact_points(link.shapes, device=device)
        of_spheres = wp.from_torch(self._points, dtype=wp.vec4)
        self.shapes = body_shapes(link.shapes, device=device) if self.cores else of_spheres


class CollisionTest:
    """Signed distance of one robot per environment to the scene, with all views made at construction."""

    def __init__(
        self,
        scene: Scene,
        shapes: Sequence[CollisionShape],
        *,
        position: Tensor,
        attitude: Tensor,
        distance_out: Tensor,
        moving: "Obstacles | None" = None,
        links: Sequence["LinkShapes"] = (),
    ) -> None:
        """Take views of the tensors, which must stay where they are.

        Args:
            scene: What must not be touched.
            shapes: The robot's collision shapes; none makes every distance infinite.
            position: Body origin [m], world, (E, 3); may be strided, but for the last axis.
            attitude: Body to world, xyzw, unit, (E, 4); likewise.
            distance_out: Receives the smallest signed distance [m], negative where they overlap, inf where there is
                nothing to touch, float32, (E,).
            moving: The instances of the scene as ``step`` moves them; None if nothing moves.
            links: Further links with shapes.

        Raises:
            ShapeError: If a tensor does not fit the scene.
        """
        check_tensor("distance_out", distance_out, (scene.num_envs,), device=scene.device)
        body = LinkShapes(shapes=tuple(shapes), position=position, attitude=attitude)
        self._links = [_Body(link, device=scene.device) for link in (body, *links) if link.shapes or link is body]
        self._scene, self._out, self._moving = scene, distance_out, moving
        self.has_solids = scene.num_solid > 0
        """Whether there is anything to touch."""
        self._kept_alive: list[object] = []
        self._nothing = torch.zeros(0, dtype=torch.bool, device=scene.device)
        self._now: list[list[RecordedLaunch]] = []
        if self.has_solids:
            poses = [(own.link.position.unsqueeze(0), own.link.attitude.unsqueeze(0)) for own in self._links]
            self._now = self._record(poses, dt=0.0, crashes=self._nothing)
        self._step: list[list[RecordedLaunch]] | None = None

    def follow(self, position: Tensor, attitude: Tensor, *, dt: float, crashes_out: Tensor) -> None:
        """Make ready for ``step``.

        Args:
            position: Body origin after each substep [m], world, (K, E, 3), or of all links, (K, E, L, 3), if there are
                ``links``; read at every step.
            attitude: Body to world, xyzw, unit, (K, E, 4) or (K, E, L, 4); likewise.
            dt: Length of a substep [s].
            crashes_out: Set where the robot touches something after any of the substeps, bool, (E,); never cleared here.

        Raises:
            ShapeError: If a tensor does not fit the scene.
        """
        check_tensor("crashes_out", crashes_out, (self._scene.num_envs,), device=self._out.device, dtype=torch.bool)
        if not len(position):
            raise ShapeError("position: a step needs at least one substep")
        poses = [(position, attitude)]
        if position.dim() == 4:
            poses = [(position[:, :, own.link.number], attitude[:, :, own.link.number]) for own in self._links]
        self._step = self._record(poses, dt=dt, crashes=crashes_out, is_step=True)

    def _record(
        self, poses: Sequence[tuple[Tensor, Tensor]], *, dt: float, crashes: Tensor, is_step: bool = False
    ) -> list[list[RecordedLaunch]]:
        """Record the launches of each link, one link after the other."""
        last = len(self._links) - 1
        return [
            self._record_link(own, *pose, dt=dt, crashes=crashes, flags=(is_step, number > 0, number == last))
            for number, (own, pose) in enumerate(zip(self._links, poses, strict=True))
        ]

    def _record_link(
        self, own: "_Body", position: Tensor, attitude: Tensor, *, dt: float, crashes: Tensor, flags: tuple[bool, ...]
    ) -> list[RecordedLaunch]:
        scene, rows = self._scene, (position.shape[0], self._scene.num_envs)
        inputs = [
            scene.arrays,
            vector_view("position", position, (*rows, 3), device=scene.device),
            vector_view("attitude", attitude, (*rows, 4), device=scene.device),
            own.shapes,
            own.hull,
            dt,
            *flags,
        ]
        outputs = [
            NoObstacles() if self._moving is None else self._moving,
            wp.from_torch(self._out),
            wp.from_torch(crashes),
        ]
        self._kept_alive.append((inputs, outputs))  # launches do not keep the memory that they read
        shared = scene.device.type == "cuda"
        return [
            RecordedLaunch(
                make_walk(moves=self._moving is not None, shared=shared, cores=own.cores),
                dim=[count],
                inputs=[*inputs, first],
                outputs=outputs,
                block_dim=BLOCK_DIM if shared else 1,
                device=wp.device_from_torch(scene.device),
                tiled=True,
            )
            for first, count in self._chunks()
        ]

    def _chunks(self) -> list[tuple[int, int]]:
        """Return first environment and number of environments of each launch."""
        envs = self._scene.num_envs
        if self._out.device.type == "cuda":
            return [(0, envs)]
        return split(envs, min(torch.get_num_threads(), max(1, envs * self._scene.num_solid // MIN_PARTS_PER_THREAD)))

    def measure(self) -> None:
        """Write the distances of the present poses; launched on torch's current stream, not waited for."""
        if not self.has_solids:
            self._out.fill_(inf)
            return
        with on_torch_stream(self._out):
            for launches in self._now:
                launch_side_by_side(launches)

    def step(self) -> None:
        """Move the obstacles by K substeps, set crashes, write the distances after the last; launched likewise."""
        if self._step is None:
            raise ShapeError("CollisionTest.step: give it the poses of the substeps first. Call follow()")
        with on_torch_stream(self._out):
            for launches in self._step:
                launch_side_by_side(launches)
