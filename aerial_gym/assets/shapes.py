"""The shape table: every distinct shape once, analytic or as one Warp mesh, however many instances use it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
import warp as wp

from aerial_gym.assets.geometry import BOX, CAPSULE, CYLINDER, MESH, PLANE, SPHERE, Shape
from aerial_gym.assets.looks import LookTable, MeshLook, look_of_mesh
from aerial_gym.assets.urdf import load_urdf_shape
from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler

if TYPE_CHECKING:
    import trimesh

_KINDS = {"box": BOX, "sphere": SPHERE, "cylinder": CYLINDER, "capsule": CAPSULE, "mesh": MESH, "plane": PLANE}

_MARGIN = 1.0 + 1e-5
"""Bounding spheres are larger by this factor, so that float32 rounding (6e-8) never rejects a shape that is hit."""

_FLAT = 1e-4
"""Bounding boxes of meshes are thicker by this share of their radius, so that a flat sheet has one too."""


RAY_TREE = {"bvh_constructor": "cubql", "bvh_leaf_size": 4}
"""The tree that rays are fastest in on a GPU; Warp gives it no winding numbers (docs/results/rendering.md)."""


class ShapeTable:
    """Shapes on a device, in the order of their configurations; a compound has a row for each part."""

    def __init__(self, shapes: Sequence[ShapeCfg], *, device: torch.device) -> None:
        """Read the meshes and fill the table.

        Raises:
            ConfigError: If a mesh or URDF file is missing, unreadable, empty or not finite.
        """
        self.shapes = tuple(load_urdf_shape(shape) if shape.kind == "urdf" else shape for shape in shapes)
        self._device = wp.device_from_torch(device)
        self._meshes: dict[tuple[str, float], _Mesh] = {}
        parts = [shape.parts or (PartCfg(shape=shape),) for shape in self.shapes]
        self.parts: tuple[PartCfg, ...] = tuple(part for group in parts for part in group)
        self.num_parts = torch.tensor([len(group) for group in parts], dtype=torch.int64, device=device)
        self.first_part = self.num_parts.cumsum(0) - self.num_parts
        inherited = [shape.color for shape, group in zip(self.shapes, parts, strict=True) for _ in group]
        looks = LookTable()
        rows = np.zeros(len(self.parts), dtype=Shape.numpy_dtype())  # type: ignore[call-overload]
        for row, part, color in zip(rows, self.parts, inherited, strict=True):
            cfg = part.shape
            looks.add(cfg, inherited=color, mesh=self._mesh(cfg).look if cfg.kind == "mesh" else None)
            row["kind"], row["size"] = _KINDS[cfg.kind], half_size(cfg)
            row["radius"], row["half"] = _MARGIN * _bounding_radius(cfg), _half_box(cfg)
            row["position"] = part.position
            row["attitude"] = quat_from_euler(torch.tensor(part.euler, dtype=torch.float64)).numpy()
            if cfg.kind == "mesh":
                mesh = self._mesh(cfg)
                row["mesh"], row["ray_mesh"], row["radius"] = mesh.solid.id, mesh.rays.id, _MARGIN * mesh.radius
                row["center"] = 0.5 * (mesh.bounds[0] + mesh.bounds[1])
                row["half"] = 0.5 * _MARGIN * (mesh.bounds[1] - mesh.bounds[0]) + _FLAT * mesh.radius
        self.array = wp.array(rows, dtype=Shape, device=self._device)
        self.looks = looks.arrays(self._device)
        self.radius = torch.tensor(rows["radius"], device=device)

    def __len__(self) -> int:
        return len(self.shapes)

    def _mesh(self, cfg: ShapeCfg) -> "_Mesh":
        key = (str(cfg.path), cfg.scale)
        if key not in self._meshes:
            pieces = _read_mesh(key[0], scale=cfg.scale)
            surface = _join(pieces, scale=cfg.scale)
            points = wp.array(surface.vertices.astype(np.float32), dtype=wp.vec3, device=self._device)
            indices = wp.array(surface.faces.astype(np.int32).ravel(), dtype=wp.int32, device=self._device)
            solid = wp.Mesh(points=points, indices=indices, support_winding_number=True)
            self._meshes[key] = _Mesh(
                solid=solid,
                rays=wp.Mesh(points=points, indices=indices, **RAY_TREE) if self._device.is_cuda else solid,
                radius=float(np.linalg.norm(surface.vertices, axis=1).max()),
                bounds=np.asarray(surface.bounds, dtype=np.float32),
                look=look_of_mesh(pieces, np.asarray(surface.faces)),
            )
        return self._meshes[key]


@dataclass(frozen=True)
class _Mesh:
    """Triangles on the device, once for distances and once for rays."""

    solid: wp.Mesh
    rays: wp.Mesh
    radius: float
    bounds: np.ndarray
    look: MeshLook | None


def load_mesh(path: str | Path, *, scale: float) -> "trimesh.Trimesh":
    """Return the triangles of a mesh file, scaled about its origin; a closed mesh is turned right side out.

    Raises:
        ConfigError: If the file is missing, unreadable, without a triangle or a surface, if a triangle names a vertex that is
            not there, or if a scaled coordinate is not a finite float32.
    """
    return _join(_read_mesh(path, scale=scale), scale=scale)


def _read_mesh(path: str | Path, *, scale: float) -> list["trimesh.Trimesh"]:
    """Return the geometries of a mesh file in place, with their colours; raise ``ConfigError`` if there is nothing usable."""
    import trimesh

    if not Path(path).is_file():
        raise ConfigError(f"mesh {path}: no such file")
    try:
        found = trimesh.load_scene(path, process=False).dump()
        pieces = [piece for piece in found if isinstance(piece, trimesh.Trimesh)]
        shapes = {(part.ndim, part.shape[-1]) for piece in pieces for part in (piece.vertices, piece.faces)}
    except Exception as error:  # trimesh's readers raise whatever their format's library raises
        raise ConfigError(f"mesh {path}: cannot be read ({' '.join(str(error).split())})") from None
    if not shapes <= {(2, 3)}:
        raise ConfigError(f"mesh {path}: a vertex needs three numbers, and a triangle three vertices")
    if sum(len(piece.faces) for piece in pieces) == 0:
        raise ConfigError(f"mesh {path}: holds no triangle")
    for piece in pieces:
        if len(piece.faces) and (piece.faces.min() < 0 or piece.faces.max() >= len(piece.vertices)):
            raise ConfigError(
                f"mesh {path}: a triangle names a vertex from {piece.faces.min()} to {piece.faces.max()}; "
                f"there are {len(piece.vertices)}, counted from 0"
            )
        if not (np.abs(piece.vertices) * scale <= np.finfo(np.float32).max).all():
            raise ConfigError(f"mesh {path}: a vertex is not finite")
    if not sum(piece.area for piece in pieces) > 0.0:
        raise ConfigError(f"mesh {path}: has no surface: the corners of each triangle lie on a line")
    return pieces


def _join(pieces: Sequence["trimesh.Trimesh"], *, scale: float) -> "trimesh.Trimesh":
    """Return one mesh without colours, vertices and triangles in the order of the pieces, scaled about its origin."""
    import trimesh

    first = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = [piece.faces + offset for piece, offset in zip(pieces, first, strict=False)]
    vertices = np.concatenate([piece.vertices for piece in pieces])
    mesh = trimesh.Trimesh(vertices=vertices, faces=np.concatenate(faces), process=False)
    mesh.apply_scale(scale)
    merged = mesh.copy()
    merged.merge_vertices()
    if merged.is_watertight and merged.volume < 0.0:
        mesh.invert()
    return mesh


def is_convex(mesh: "trimesh.Trimesh") -> bool:
    """Return whether a mesh is one closed body that holds every line between two of its points."""
    merged = mesh.copy()
    merged.merge_vertices()
    return bool(merged.is_watertight and merged.is_convex and merged.body_count == 1)


def half_size(cfg: ShapeCfg) -> tuple[float, float, float]:
    """Return half the edges of a box [m], or the radius and half the height of what has them; 0 for what it has not."""
    if cfg.size is not None:
        return 0.5 * cfg.size[0], 0.5 * cfg.size[1], 0.5 * cfg.size[2]
    return cfg.radius or 0.0, 0.5 * (cfg.height or 0.0), 0.0


def _half_box(cfg: ShapeCfg) -> tuple[float, float, float]:
    a, b, c = half_size(cfg)
    if cfg.kind == "box":
        return a, b, c
    if cfg.kind == "plane":
        return 1.0, 1.0, 1.0  # has no bounding box: its frame is not scaled
    return a, a, {"cylinder": b, "capsule": a + b}.get(cfg.kind, a)


def _bounding_radius(cfg: ShapeCfg) -> float:
    a, b, c = half_size(cfg)
    if cfg.kind == "plane":
        return inf
    if cfg.kind == "box":
        return hypot(a, b, c)
    return hypot(a, b) if cfg.kind == "cylinder" else a + b
