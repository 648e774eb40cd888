# pyright: reportArgumentType=false, reportAssignmentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# pyright: reportOptionalMemberAccess=false
# (Warp compiles the kernel from its source; Python's type rules do not describe it.)
"""Baseline of ``bench render``: all obstacles of an environment as one triangle mesh.

``merged`` is the method of the Aerial Gym Simulator: a mesh per environment, a query per pixel in the order of rows. At
most ``DISTINCT`` environments are built and shared by the others, which saves minutes and favours the baseline, as its
trees stay in the cache. ``shared_mesh`` is a lower bound for triangles: one mesh for all environments, which must be equal,
with neighbouring pixels in one block. Depth only.
"""

import numpy as np
import torch
import trimesh
import warp as wp

from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.interop import on_torch_stream
from aerial_gym.math.quaternion import quat_from_euler, quat_to_matrix
from aerial_gym.sensors.rays import make_tiles
from aerial_gym.workloads.scenes import RenderScene

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
