# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false, reportOptionalMemberAccess=false

"""The scenes of ``bench render``: shapes, obstacle states and where the cameras are.

Frames: world of each environment, z up. Letters: E environments, A instances.

Baseline of ``bench render``: all obstacles of an environment as one triangle mesh.

``merged`` is the method of the Aerial Gym Simulator: a mesh per environment, a query per pixel in the order of rows. At
most ``DISTINCT`` environments are built and shared by the others, which saves minutes and favours the baseline, as its
trees stay in the cache. ``shared_mesh`` is a lower bound for triangles: one mesh for all environments, which must be equal,
with neighbouring pixels in one block. Depth only.
"""

import math
import random
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import trimesh
import warp as wp
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS, Scene
from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.env_manager import SimBuilder
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.interop import on_torch_stream
from aerial_gym.math.quaternion import quat_from_euler, quat_to_matrix
from aerial_gym.sensors.rays import make_tiles


@dataclass(frozen=True, kw_only=True)
class RenderScene:
    """Scene of a camera in every environment."""

    shapes: tuple[ShapeCfg, ...]  # One for each instance
    state: Tensor  # Position, attitude xyzw, velocities, (E, A, 13)
    position: Tensor  # Of the cameras [m], (E, 3), or (E V, 3) with V vehicles in an environment
    attitude: Tensor  # Camera (along its x) to world, xyzw, (E, 4) or (E V, 4)
    max_range: float  # [m]
    built: Scene | None = None  # The scene, where it is there already

    def build(self) -> Scene:
        """Return the scene; instance a shows id a."""
        if self.built is not None:
            return self.built
        rows = torch.arange(len(self.shapes))
        return Scene(self.shapes, shape_index=rows, semantic_id=rows, asset_state=self.state)


def make_scene(name: str, num_envs: int, *, device: torch.device, vehicles: int = 1) -> RenderScene:
    """Return a scene by name, or a registered environment with vehicles as its first reset leaves it."""
    if name in SCENES:
        if vehicles > 1:
            raise ConfigError(
                f"--vehicles {vehicles} with --scene {name}: a scene without vehicles. Use an environment"
            )
        return SCENES[name](num_envs, device)
    if name not in ENVIRONMENTS:
        known = (*sorted(SCENES), *ENVIRONMENTS.names())
        raise UnknownNameError(f"no render scene {name!r}. Known: {', '.join(known)}")
    return _environment_scene(name, num_envs, device, vehicles)


def _environment_scene(name: str, num_envs: int, device: torch.device, vehicles: int) -> RenderScene:
    """Return a registered environment, seen by the cameras of quadrotors at their starts."""
    names: dict[str, Any] = {"sim_name": "base_sim", "env_name": name, "controller_name": "no_control"}
    robots = [{"name": "base_quadrotor", "count": vehicles}]
    env = SimBuilder().build_env(**names, robots=robots, num_envs=num_envs, device=device)
    env.reset()
    bodies = env.kinds["base_quadrotor"].bodies
    return RenderScene(
        shapes=(), state=env.gtd["env_asset_state_tensor"], position=bodies["robot_position"],
        attitude=bodies["robot_orientation"], max_range=10.0, built=env.asset_manager.scene,
    )  # fmt: skip


def _scene_on_device(
    shapes: Iterable[ShapeCfg], state: Tensor, position: Tensor, attitude: Tensor, max_range: float,
    device: torch.device,
) -> RenderScene:  # fmt: skip
    state, position, attitude = (tensor.to(device) for tensor in (state, position, attitude))
    return RenderScene(shapes=tuple(shapes), state=state, position=position, attitude=attitude, max_range=max_range)


def _floor_with_boxes(num_envs: int, device: torch.device, *, turned: bool = True) -> RenderScene:
    """Return a floor and 20 boxes 2 to 8 m ahead of a camera 1 m above the floor; every box turned at random."""
    chance = random.Random(1)
    rows, shapes = [], []
    for _ in range(20):
        distance, bearing = chance.uniform(2.0, 8.0), chance.uniform(-0.7, 0.7)
        half = [chance.uniform(0.1, 0.5) for _ in range(3)]
        height = chance.uniform(0.2, 2.0)
        rows.append((distance * math.cos(bearing), distance * math.sin(bearing), height))
        shapes.append(ShapeCfg(kind="box", size=(2.0 * half[0], 2.0 * half[1], 2.0 * half[2])))
    shapes.append(ShapeCfg(kind="box", size=(40.0, 40.0, 0.2)))
    rows.append((0.0, 0.0, -0.1))
    state = torch.zeros(num_envs, 21, 13)
    state[..., :3], state[..., 6] = torch.tensor(rows), 1.0
    if turned:
        angles = math.pi * (2.0 * torch.rand(num_envs, 20, 3, generator=torch.Generator().manual_seed(0)) - 1.0)
        state[:, :20, 3:7] = quat_from_euler(angles)
    position, attitude = torch.zeros(num_envs, 3), torch.zeros(num_envs, 4)
    position[:, 2], attitude[:, 3] = 1.0, 1.0
    return _scene_on_device(shapes, state, position, attitude, 50.0, device)


def _tree_shape(seed: int) -> ShapeCfg:
    """Return a tree of a trunk and 12 branches, all cylinders, 3 m high."""
    chance = random.Random(seed)
    parts = [PartCfg(shape=ShapeCfg(kind="cylinder", radius=0.12, height=3.0), position=(0.0, 0.0, 1.5))]
    for _ in range(12):
        length, radius = chance.uniform(0.5, 1.5), chance.uniform(0.02, 0.06)
        tilt, bearing, foot = chance.uniform(0.5, 1.3), chance.uniform(-math.pi, math.pi), chance.uniform(0.8, 2.9)
        reach = 0.5 * length * math.sin(tilt)
        place = (reach * math.cos(bearing), reach * math.sin(bearing), foot + 0.5 * length * math.cos(tilt))
        branch = ShapeCfg(kind="cylinder", radius=radius, height=length)
        parts.append(PartCfg(shape=branch, position=place, euler=(0.0, tilt, bearing)))
    return ShapeCfg(kind="compound", parts=tuple(parts))


def _room_with_obstacles(num_envs: int, device: torch.device) -> RenderScene:
    """Return a room of 6 walls with 12 boxes, 10 spheres, 4 cylinders and 8 trees; cameras anywhere, at any heading."""
    chance, draw = random.Random(2), torch.Generator().manual_seed(2)
    walls = ((0.2, 10.0, 6.0), (10.0, 0.2, 6.0), (10.0, 10.0, 0.2))
    shapes = [ShapeCfg(kind="box", size=size) for size in walls for _ in range(2)]
    for _ in range(12):
        a, b, c = (chance.uniform(0.2, 1.0) for _ in range(3))
        shapes.append(ShapeCfg(kind="box", size=(a, b, c)))
    shapes += [ShapeCfg(kind="sphere", radius=chance.uniform(0.15, 0.45)) for _ in range(10)]
    shapes += [ShapeCfg(kind="cylinder", radius=0.15, height=2.0) for _ in range(4)]
    shapes += [_tree_shape(seed) for seed in range(8)]
    state = torch.zeros(num_envs, len(shapes), 13)
    middles = ((5.1, 0, 3), (-5.1, 0, 3), (0, 5.1, 3), (0, -5.1, 3), (0, 0, -0.1), (0, 0, 6.1))
    state[:, :6, :3], state[..., 6] = torch.tensor(middles, dtype=torch.float32), 1.0
    shares = torch.rand(num_envs, len(shapes) - 6, 3, generator=draw)
    state[:, 6:, :3] = torch.tensor([-4.5, -4.5, 0.5]) + shares * torch.tensor([9.0, 9.0, 5.0])
    angles = math.pi * (2.0 * torch.rand(num_envs, len(shapes) - 6, 3, generator=draw) - 1.0)
    angles[:, -8:, :2] = 0.0  # trees are upright
    state[:, -8:, 2] = 0.0
    state[:, 6:, 3:7] = quat_from_euler(angles)
    position = torch.tensor([-4.0, -4.0, 1.0]) + torch.rand(num_envs, 3, generator=draw) * torch.tensor([8.0, 8.0, 4.0])
    heading = torch.zeros(num_envs, 3)
    heading[:, 2] = 2.0 * math.pi * torch.rand(num_envs, generator=draw)
    return _scene_on_device(shapes, state, position, quat_from_euler(heading), 20.0, device)


def _many_boxes(num_envs: int, device: torch.device, count: int) -> RenderScene:
    """Return ``count`` turned boxes of 20 to 80 cm in the 12 m cube around a camera in its middle."""
    draw = torch.Generator().manual_seed(count)
    edges = 0.2 + 0.6 * torch.rand(count, 3, generator=draw)
    shapes = tuple(ShapeCfg(kind="box", size=(a, b, c)) for a, b, c in edges.tolist())
    state = torch.zeros(num_envs, count, 13)
    state[..., :3] = 12.0 * (torch.rand(num_envs, count, 3, generator=draw) - 0.5)
    state[..., 3:7] = quat_from_euler(2.0 * math.pi * torch.rand(num_envs, count, 3, generator=draw) - math.pi)
    attitude = torch.zeros(num_envs, 4)
    attitude[:, 3] = 1.0
    return _scene_on_device(shapes, state, torch.zeros(num_envs, 3), attitude, 20.0, device)


SCENES = {
    "boxes_100": lambda num_envs, device: _many_boxes(num_envs, device, 100),
    "boxes_1000": lambda num_envs, device: _many_boxes(num_envs, device, 1000),
    "boxes": _floor_with_boxes,
    "boxes_aligned": lambda num_envs, device: _floor_with_boxes(num_envs, device, turned=False),
    "clutter": _room_with_obstacles,
}
"""Scenes by the name that a user chooses."""


DISTINCT = 64  # Environments that are really built


@wp.kernel(enable_backward=False)
def _cast_scene(
    mesh: wp.array[wp.uint64],  # (E,)
    position: wp.array[wp.vec3],  # (E,) world [m]
    attitude: wp.array[wp.quat],  # (E,) camera to world
    direction: wp.array[wp.vec3],  # (N,) camera frame, unit
    order: wp.array[wp.int32],  # (N,) which pixel a thread draws
    max_range: float,  # [m]
    out: wp.array2d[float],  # (E, N) [m]
):
    """Write the depth along the optical axis, -1 for a miss."""
    env, thread = wp.tid()
    pixel = order[thread]
    ray = direction[pixel]
    limit = max_range / ray[0]
    query = wp.mesh_query_ray(mesh[env], position[env], wp.quat_rotate(attitude[env], ray), limit)
    out[env, pixel] = wp.where(query.result, query.t * ray[0], -1.0)


class SceneMeshes:
    """One merged mesh per environment, and the launch that renders all."""

    def __init__(self, scene: RenderScene, direction: torch.Tensor, *, shared: bool = False) -> None:
        """Triangulate and merge.

        Args:
            direction: The ray table, (H, W, 3).
            shared: One mesh for all environments, pixels in tiles; else a mesh for each, pixels in rows.
        """
        device, num_envs = wp.device_from_torch(scene.state.device), scene.state.shape[0]
        self.meshes = [
            self._merge_environment(scene, env, device) for env in range(min(num_envs, 1 if shared else DISTINCT))
        ]
        order = torch.arange(direction[..., 0].numel(), dtype=torch.int32, device=direction.device)
        if shared:
            tiles = make_tiles(direction, height=8, width=8)
            order = tiles.pixel[tiles.pixel >= 0]
        direction = direction.reshape(-1, 3)
        self.num_triangles = len(self.meshes[0].indices) // 3
        ids = np.array([self.meshes[env % len(self.meshes)].id for env in range(num_envs)], dtype=np.uint64)
        self.depth = torch.zeros(num_envs, len(direction), device=scene.state.device)
        mesh_index = torch.arange(num_envs, device=scene.state.device) % len(self.meshes)
        self._kept = order, direction
        self._position = scene.position[mesh_index].contiguous()
        self._attitude = scene.attitude[mesh_index].contiguous()
        self._launch = wp.launch(
            _cast_scene,
            dim=(num_envs, len(direction)),
            inputs=[
                wp.array(ids, dtype=wp.uint64, device=device),
                wp.from_torch(self._position, dtype=wp.vec3),
                wp.from_torch(self._attitude, dtype=wp.quat),
                wp.from_torch(direction.contiguous(), dtype=wp.vec3),
                wp.from_torch(order.contiguous()),
                scene.max_range,
            ],
            outputs=[wp.from_torch(self.depth)],
            device=device,
            record_cmd=True,
        )

    def cast(self) -> None:
        """Render every environment."""
        with on_torch_stream(self.depth):
            self._launch.launch()

    @staticmethod
    def _merge_environment(scene: RenderScene, env: int, device: wp.Device) -> wp.Mesh:
        pieces = []
        for shape, row in zip(scene.shapes, scene.state[env].cpu(), strict=True):
            turn = quat_to_matrix(row[3:7].double()).numpy()
            for part in shape.parts or (PartCfg(shape=shape),):
                piece = _shape_triangles(part.shape)
                local = quat_to_matrix(quat_from_euler(torch.tensor(part.euler, dtype=torch.float64))).numpy()
                points = (piece.vertices @ local.T + np.array(part.position)) @ turn.T + row[:3].numpy()
                pieces.append(trimesh.Trimesh(points, piece.faces, process=False))
        merged = trimesh.util.concatenate(pieces)
        return wp.Mesh(
            points=wp.array(merged.vertices.astype(np.float32), dtype=wp.vec3, device=device),
            indices=wp.array(merged.faces.astype(np.int32).ravel(), dtype=wp.int32, device=device),
        )


def _shape_triangles(shape: ShapeCfg) -> trimesh.Trimesh:
    if shape.kind == "box":
        return trimesh.creation.box(extents=shape.size)
    if shape.kind == "sphere":
        return trimesh.creation.icosphere(subdivisions=2, radius=shape.radius)
    return trimesh.creation.cylinder(radius=shape.radius, height=shape.height, sections=16)
