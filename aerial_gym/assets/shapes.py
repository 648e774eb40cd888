"""The shape table: every distinct shape once, analytic or as one Warp mesh, shared by all instances."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf

import numpy as np
import torch
import warp as wp

from aerial_gym.assets.appearance import AppearanceTable, MeshAppearance, read_mesh_appearance
from aerial_gym.assets.mesh_files import join_pieces, read_pieces
from aerial_gym.assets.scene_arrays import BOX, CAPSULE, CYLINDER, MESH, PLANE, SPHERE, Shape
from aerial_gym.assets.urdf import load_urdf_shape
from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.math.quaternion import quat_from_euler

_KINDS = {"box": BOX, "sphere": SPHERE, "cylinder": CYLINDER, "capsule": CAPSULE, "mesh": MESH, "plane": PLANE}

_MARGIN = 1.0 + 1e-5  # Factor on bounding spheres, so that float32 rounding (6e-8) rejects no shape that is hit
_FLAT = 1e-4  # Added thickness of mesh bounding boxes per radius, so that a flat sheet has a volume


RAY_TREE = {"bvh_constructor": "cubql", "bvh_leaf_size": 4}  # Fastest for rays on a GPU, without winding numbers


class ShapeTable:
    """Shapes on a device, in the order of their configurations; a compound has a row for each part."""

    def __init__(self, shapes: Sequence[ShapeCfg], *, device: torch.device) -> None:
        """Read the meshes and fill the table; raise ``ConfigError`` for a mesh or URDF file that cannot be used."""
        self.shapes = tuple(load_urdf_shape(shape) if shape.kind == "urdf" else shape for shape in shapes)
        self._device = wp.device_from_torch(device)
        self._meshes: dict[tuple[str, float, str | None], _Mesh] = {}
        parts = [shape.parts or (PartCfg(shape=shape),) for shape in self.shapes]
        self.parts: tuple[PartCfg, ...] = tuple(part for group in parts for part in group)
        self.num_parts = torch.tensor([len(group) for group in parts], dtype=torch.int64, device=device)
        self.first_part = self.num_parts.cumsum(0) - self.num_parts
        inherited = [shape.color for shape, group in zip(self.shapes, parts, strict=True) for _ in group]
        looks = AppearanceTable()
        rows = np.zeros(len(self.parts), dtype=Shape.numpy_dtype())  # type: ignore[call-overload]
        for row, part, color in zip(rows, self.parts, inherited, strict=True):
            cfg = part.shape
            looks.add(cfg, inherited=color, mesh=self._load_mesh(cfg).look if cfg.kind == "mesh" else None)
            row["kind"], row["size"] = _KINDS[cfg.kind], half_size(cfg)
            row["radius"], row["half"] = _MARGIN * _bounding_radius(cfg), _half_edges_of_bounds(cfg)
            row["position"] = part.position
            row["attitude"] = quat_from_euler(torch.tensor(part.euler, dtype=torch.float64)).numpy()
            if cfg.kind == "mesh":
                mesh = self._load_mesh(cfg)
                row["mesh"], row["ray_mesh"], row["radius"] = mesh.solid.id, mesh.rays.id, _MARGIN * mesh.radius
                row["center"] = 0.5 * (mesh.bounds[0] + mesh.bounds[1])
                row["half"] = 0.5 * _MARGIN * (mesh.bounds[1] - mesh.bounds[0]) + _FLAT * mesh.radius
        self.array = wp.array(rows, dtype=Shape, device=self._device)
        self.looks = looks.arrays(self._device)
        self.radius = torch.tensor(rows["radius"], device=device)

    def __len__(self) -> int:
        return len(self.shapes)

    def _load_mesh(self, cfg: ShapeCfg) -> "_Mesh":
        key = (str(cfg.path), cfg.scale, cfg.up)
        if key not in self._meshes:
            pieces = read_pieces(key[0], scale=cfg.scale, up=cfg.up)
            surface = join_pieces(pieces, scale=cfg.scale)
            points = wp.array(surface.vertices.astype(np.float32), dtype=wp.vec3, device=self._device)
            indices = wp.array(surface.faces.astype(np.int32).ravel(), dtype=wp.int32, device=self._device)
            solid = wp.Mesh(points=points, indices=indices, support_winding_number=True)
            self._meshes[key] = _Mesh(
                solid=solid,
                rays=wp.Mesh(points=points, indices=indices, **RAY_TREE) if self._device.is_cuda else solid,
                radius=float(np.linalg.norm(surface.vertices, axis=1).max()),
                bounds=np.asarray(surface.bounds, dtype=np.float32),
                look=read_mesh_appearance(pieces, np.asarray(surface.faces)),
            )
        return self._meshes[key]


@dataclass(frozen=True)
class _Mesh:
    """Triangles on the device, once for distances and once for rays."""

    solid: wp.Mesh
    rays: wp.Mesh
    radius: float
    bounds: np.ndarray
    look: MeshAppearance | None


def half_size(cfg: ShapeCfg) -> tuple[float, float, float]:
    """Return the half edges of a box [m], or radius, half height and 0 of other shapes; missing sizes are 0."""
    if cfg.size is not None:
        return 0.5 * cfg.size[0], 0.5 * cfg.size[1], 0.5 * cfg.size[2]
    return cfg.radius or 0.0, 0.5 * (cfg.height or 0.0), 0.0


def _half_edges_of_bounds(cfg: ShapeCfg) -> tuple[float, float, float]:
    a, b, c = half_size(cfg)
    if cfg.kind == "box":
        return a, b, c
    if cfg.kind == "plane":
        return 1.0, 1.0, 1.0  # a plane has no bounding box
    return a, a, {"cylinder": b, "capsule": a + b}.get(cfg.kind, a)


def _bounding_radius(cfg: ShapeCfg) -> float:
    a, b, c = half_size(cfg)
    if cfg.kind == "plane":
        return inf
    if cfg.kind == "box":
        return hypot(a, b, c)
    return hypot(a, b) if cfg.kind == "cylinder" else a + b
