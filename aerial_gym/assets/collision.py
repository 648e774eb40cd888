"""The collision test: distance of the robot's shapes to the scene, and contacts during a step.

Shapes on links of an articulated robot are tested link by link, each with the poses of its own frame. All substeps of a step
are one launch for each link (``collision_kernel``).
Frames: centres of shapes in the body frame, poses in the environment's world frame. Letters: E environments, B vehicles of all
environments, which equals E for one in each, L links, K substeps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.body_shapes import body_shapes
from aerial_gym.assets.collision_kernel import NoObstacles, make_collision_kernel
from aerial_gym.assets.cores import body_reach, contact_points, has_boxes_or_capsules
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import check_tensor, vector_view
from aerial_gym.config.checks import Vec3
from aerial_gym.config.robot import CollisionShape
from aerial_gym.errors import ShapeError
from aerial_gym.interop import ReusableLaunch, launch_side_by_side, on_torch_stream, split

BLOCK_DIM = 64  # Threads per environment on a GPU
MIN_PARTS_PER_THREAD = 8192  # Least parts per CPU thread; with fewer the start of the thread (50 µs) costs more
_ROUNDING = 1.0 + 1e-5  # Bounding spheres are larger by this factor, as in the shape table


@dataclass(frozen=True, kw_only=True)
class LinkGeometry:
    """Collision shapes of one link, and the link's pose."""

    shapes: Sequence[CollisionShape]  # In the frame of the link
    number: int = 0  # Index of the link; 0 for the body
    position: Tensor  # Origin of the frame [m], world, (B, 3); may be strided, but for the last axis
    attitude: Tensor  # To the world, xyzw, unit, (B, 4); likewise
    pivot: Vec3 = (0.0, 0.0, 0.0)  # Point that moves straight between two poses [m]: the hinge of a revolute link


class _LinkShapes:
    """Kernel arrays of the shapes of one link."""

    def __init__(self, link: LinkGeometry, *, device: torch.device) -> None:
        self.link, self.cores, self.hull = link, has_boxes_or_capsules(link.shapes), _ROUNDING * body_reach(link.shapes)
        self._points = contact_points(link.shapes, device=device)
        of_spheres = wp.from_torch(self._points, dtype=wp.vec4)
        self.shapes = body_shapes(link.shapes, device=device) if self.cores else of_spheres


class CollisionTest:
    """Signed distances of the vehicles to the scene; all views are made at construction."""

    def __init__(
        self, scene: Scene, shapes: Sequence[CollisionShape], *, position: Tensor, attitude: Tensor,
        distance_out: Tensor, moving: "Obstacles | None" = None, links: Sequence["LinkGeometry"] = (),
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are.

        Args:
            shapes: The robot's collision shapes; without any, every distance is infinite.
            position: Body origin [m], world, (B, 3); may be strided, but for the last axis.
            attitude: Body to world, xyzw, unit, (B, 4); likewise.
            distance_out: Receives the smallest signed distance [m], negative for an overlap, inf without solid parts,
                float32, (B,).
            moving: Instances of the scene that ``step`` moves; None if all are at rest.
        """
        check_tensor("distance_out", distance_out, (position.shape[0],), device=scene.device)
        self._vehicles = position.shape[0] // scene.num_envs
        body = LinkGeometry(shapes=tuple(shapes), position=position, attitude=attitude)
        self._links = [_LinkShapes(link, device=scene.device) for link in (body, *links) if link.shapes or link is body]
        self._scene, self._out, self._moving = scene, distance_out, moving
        self.has_solids = scene.num_solid > 0
        """Whether there is anything to touch."""
        self._nothing = torch.zeros(0, dtype=torch.bool, device=scene.device)
        self._now: list[list[ReusableLaunch]] = []
        if self.has_solids:
            poses = [(own.link.position.unsqueeze(0), own.link.attitude.unsqueeze(0)) for own in self._links]
            self._now = self._record_launches_of_links(poses, dt=0.0, crashes=self._nothing)
        self._step: list[list[ReusableLaunch]] | None = None

    def record_launches(
        self, position: Tensor, attitude: Tensor, *, dt: float, crashes_out: Tensor, moves_obstacles: bool = True
    ) -> None:  # fmt: skip
        """Record the launches of ``step``.

        Args:
            position: Body origin at the start of a step and after each substep [m], world, (K + 1, B, 3), or of all links,
                (K + 1, B, L, 3), if there are ``links``; read at every step.
            attitude: Body to world, xyzw, unit, (K + 1, B, 4) or (K + 1, B, L, 4); likewise.
            dt: Length of a substep [s].
            crashes_out: Set at a contact of the robot at or between these poses, bool, (B,); never cleared here.
            moves_obstacles: Whether moving obstacles end where they are after the step: with the last of several tests.
        """
        check_tensor("crashes_out", crashes_out, (len(self._out),), device=self._out.device, dtype=torch.bool)
        if len(position) < 2:
            raise ShapeError(f"position has {len(position)} rows: a step needs its start and at least one substep")
        poses = [(position, attitude)]
        if position.dim() == 4:
            poses = [(position[:, :, own.link.number], attitude[:, :, own.link.number]) for own in self._links]
        alone = moves_obstacles and self._vehicles == 1
        flags = {"is_step": True, "moves_obstacles": alone}
        self._step = self._record_launches_of_links(poses, dt=dt, crashes=crashes_out, **flags)
        if (
            self._moving is not None and moves_obstacles and not alone
        ):  # apart: all vehicles read the poses of the start
            from aerial_gym.assets.obstacle_motion import make_motion_launch

            self._step.append([make_motion_launch(self._moving, dt, steps=len(position) - 1)])

    def _record_launches_of_links(
        self, poses: Sequence[tuple[Tensor, Tensor]], *, dt: float, crashes: Tensor, is_step: bool = False,
        moves_obstacles: bool = False,
    ) -> list[list[ReusableLaunch]]:  # fmt: skip
        """Record the launches link by link."""
        last = len(self._links) - 1 if moves_obstacles else -1
        return [
            self._record_link_launches(own, *pose, dt=dt, crashes=crashes, flags=(is_step, number > 0, number == last))
            for number, (own, pose) in enumerate(zip(self._links, poses, strict=True))
        ]

    def _record_link_launches(
        self, own: _LinkShapes, position: Tensor, attitude: Tensor, *, dt: float, crashes: Tensor,
        flags: tuple[bool, ...],
    ) -> list[ReusableLaunch]:  # fmt: skip
        scene, rows = self._scene, (position.shape[0], len(self._out))
        inputs = [
            scene.arrays, vector_view("position", position, (*rows, 3), device=scene.device),
            vector_view("attitude", attitude, (*rows, 4), device=scene.device), own.shapes, own.hull,
            wp.vec3(*own.link.pivot), dt, *flags, self._vehicles,
        ]  # fmt: skip
        moves, shared = self._moving is not None, scene.device.type == "cuda"
        outputs = [self._moving if moves else NoObstacles(), self._out, crashes]
        kernel = make_collision_kernel(moves=moves, shared=shared, cores=own.cores, meshes=scene.has_meshes)
        launch = {"outputs": outputs, "block_dim": BLOCK_DIM if shared else 1, "device": scene.device, "tiled": True}
        return [
            ReusableLaunch(kernel, dim=[count], inputs=[*inputs, first], **launch) for first, count in self._chunks()
        ]

    def _chunks(self) -> list[tuple[int, int]]:
        """Return the first vehicle and the number of vehicles of each launch."""
        count = len(self._out)
        if self._out.device.type == "cuda":
            return [(0, count)]
        return split(count, min(torch.get_num_threads(), max(1, count * self._scene.num_solid // MIN_PARTS_PER_THREAD)))

    def measure(self) -> None:
        """Launch the measurement at the present poses on torch's current stream."""
        if self.has_solids:
            self._launch(self._now)
        else:
            self._out.fill_(inf)

    def step(self) -> None:
        """Launch a step: move the obstacles by K substeps, set crashes, write the distances after the last substep."""
        if self._step is None:
            raise ShapeError("CollisionTest.step: the poses of the substeps are missing. Call follow() first")
        self._launch(self._step)

    def _launch(self, launches_by_link: list[list[ReusableLaunch]]) -> None:
        with on_torch_stream(self._out):
            for launches in launches_by_link:
                launch_side_by_side(launches)
