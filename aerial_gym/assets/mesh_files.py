"""Mesh files as triangles in metres, z up.

Collada states its unit and up axis (metres and y up if it does not). glTF is in metres and y up. 3MF states its unit. STL,
OBJ and PLY state neither, and are taken as metres, z up.

For meshes of URDF and SDF files, Collada's up axis is ignored: RViz 2, MoveIt and Gazebo do not turn such files either. The
unit still counts, and glTF is turned.

Source: COLLADA 1.4.1, elements unit and up_axis; glTF 2.0, section 3.4; rviz_rendering, assimp_loader.cpp (ignores the up
axis of Collada, turns glTF to (x, -z, y)); gz-common, AssimpLoader.cc, and gazebo-classic, issue 1305 (neither turns
Collada).
"""

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from aerial_gym.errors import ConfigError

if TYPE_CHECKING:
    import trimesh

_TO_Z_UP = {
    "x": ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""Rotations that turn the up axis of a file to z and keep its right-hand side. Source: COLLADA 1.4.1, table of up_axis."""


def load_mesh(path: str | Path, *, scale: float, up: str | None = None) -> "trimesh.Trimesh":
    """Return the triangles of a mesh file in metres, z up, scaled about its origin; normals of a closed mesh point outwards.

    Args:
        scale: Factor on the coordinates, after the unit of the file.
        up: Axis of the file that points up (``x``, ``y``, ``z``); overrides the file's own.
    """
    return join_pieces(read_pieces(path, scale=scale, up=up), scale=scale)


def is_collada(path: str | Path) -> bool:
    """Return whether a file's name is that of a Collada file."""
    return Path(path).suffix.lower() == ".dae"


def read_pieces(path: str | Path, *, scale: float, up: str | None) -> list["trimesh.Trimesh"]:
    """Return the geometries of a mesh file in place [m], z up, not yet scaled, with their colours."""
    import trimesh

    if not Path(path).is_file():
        raise ConfigError(f"mesh {path}: no such file")
    try:
        scene = trimesh.load_scene(path, process=False)
        pieces = [piece for piece in scene.dump() if isinstance(piece, trimesh.Trimesh)]
        shapes = {(part.ndim, part.shape[-1]) for piece in pieces for part in (piece.vertices, piece.faces)}
        metre = 1.0 if scene.units is None else trimesh.units.unit_conversion(scene.units, "meters")
        axis = up or _up_axis(path)
    except Exception as error:  # trimesh's readers raise whatever their format's library raises
        raise ConfigError(f"mesh {path}: cannot be read ({' '.join(str(error).split())})") from None
    if not shapes <= {(2, 3)}:
        raise ConfigError(f"mesh {path}: a vertex needs three numbers, and a triangle three vertices")
    if sum(len(piece.faces) for piece in pieces) == 0:
        raise ConfigError(f"mesh {path}: holds no triangle")
    if not 0.0 < metre < inf:
        raise ConfigError(f"mesh {path}: its unit is {metre:g} m: must be > 0 and finite")
    for piece in pieces:
        _to_z_up_metres(piece, metre, axis)
        _check_vertices(piece, path, scale)
    if not sum(piece.area for piece in pieces) > 0.0:
        raise ConfigError(f"mesh {path}: has no surface: the corners of each triangle lie on a line")
    return pieces


def _up_axis(path: str | Path) -> str:
    """Return the up axis by the rules of the file's format: ``x``, ``y`` or ``z``."""
    if Path(path).suffix.lower() in (".glb", ".gltf"):
        return "y"
    if not is_collada(path):
        return "z"
    for _, element in ElementTree.iterparse(path):
        tag = element.tag.rpartition("}")[2]
        if tag == "up_axis" and (element.text or "").strip() in ("X_UP", "Y_UP", "Z_UP"):
            return (element.text or "").strip()[0].lower()
        if tag == "asset":
            break
    return "y"


def _to_z_up_metres(piece: "trimesh.Trimesh", metre: float, axis: str) -> None:
    if metre == 1.0 and axis == "z":
        return
    turn = np.eye(4)
    turn[:3, :3] = metre * np.array(_TO_Z_UP[axis])
    piece.apply_transform(turn)


def _check_vertices(piece: "trimesh.Trimesh", path: str | Path, scale: float) -> None:
    if len(piece.faces) and (piece.faces.min() < 0 or piece.faces.max() >= len(piece.vertices)):
        raise ConfigError(
            f"mesh {path}: a triangle names a vertex from {piece.faces.min()} to {piece.faces.max()}; "
            f"there are {len(piece.vertices)}, counted from 0"
        )
    if not (np.abs(piece.vertices) * scale <= np.finfo(np.float32).max).all():
        raise ConfigError(f"mesh {path}: a vertex is not finite")


def join_pieces(pieces: Sequence["trimesh.Trimesh"], *, scale: float) -> "trimesh.Trimesh":
    """Join pieces into one mesh without colours, in their order, scaled about the origin."""
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
    """Return whether a mesh is one closed convex body."""
    merged = mesh.copy()
    merged.merge_vertices()
    return bool(merged.is_watertight and merged.is_convex and merged.body_count == 1)
