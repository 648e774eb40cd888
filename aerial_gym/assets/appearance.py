"""Appearance of surfaces: colour and checkerboard of every shape, and the colours and textures of mesh files.

Colours are red, green, blue in 0 to 1; those of files are taken as they stand, without a gamma curve. Texture coordinates
(u, v) have their origin at the lower left of the image, u to the right. Kernels without colour images read none of these.
Letters: K shapes, F triangles of all meshes together, V vertices of a mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray

from aerial_gym.config.robot import Vec3
from aerial_gym.config.shape import ShapeCfg

if TYPE_CHECKING:
    import trimesh

DEFAULT_COLORS: dict[str, Vec3] = {
    "box": (0.66, 0.63, 0.58), "sphere": (0.62, 0.47, 0.44), "cylinder": (0.50, 0.56, 0.62),
    "capsule": (0.55, 0.52, 0.62), "plane": (0.42, 0.45, 0.36), "mesh": (0.70, 0.70, 0.70),
}  # fmt: skip
"""Default colours of shapes. Plain choices: muted and distinct."""

NO_ENTRY = wp.constant(-1)  # Marks the absence of coloured triangles or of a texture


@wp.struct
class Appearance:
    """Appearance of one shape."""

    color: wp.vec3
    checker_color: wp.vec3
    checker_size: wp.float32  # of a field [m]; 0 for none
    first_face: wp.int32  # in the arrays of triangles, or NO_ENTRY


@wp.struct
class Texture:
    """Position of an image in the array of texels: rows from the top, each from the left."""

    first: wp.int32
    width: wp.int32
    height: wp.int32


@wp.struct
class AppearanceArrays:
    """Appearance of all surfaces of a scene."""

    shape: wp.array[Appearance]  # (K,)
    corner_color: wp.array[wp.vec3]  # (3 F,)
    corner_uv: wp.array[wp.vec2]  # (3 F,)
    face_texture: wp.array[wp.int32]  # (F,) or NO_ENTRY
    textures: wp.array[Texture]
    texels: wp.array[wp.vec3ub]  # of all textures


@dataclass(frozen=True)
class MeshAppearance:
    """The colours of one mesh file; a texture is multiplied by the colour of the corners."""

    color: NDArray[np.float32]  # Of the corners of the triangles, (F, 3, 3)
    uv: NDArray[np.float32]  # Texture coordinates of the corners, (F, 3, 2)
    texture: NDArray[np.int32]  # Index of each triangle's image, -1 for none, (F,)
    images: tuple[NDArray[np.uint8], ...]  # Each (H, W, 3)


def read_mesh_appearance(pieces: Sequence["trimesh.Trimesh"], faces: NDArray[np.int64]) -> MeshAppearance | None:
    """Return the colours of a mesh made of trimesh pieces; None if no piece has colours.

    Args:
        faces: Vertices of all triangles, numbered through all pieces, (F, 3). Triangles have the order of the pieces; the
            order within a triangle may differ.
    """
    if not any(piece.visual is not None and piece.visual.defined for piece in pieces):
        return None
    vertex_color, face_color, uv, texture, images = [], [], [], [], []
    for piece in pieces:
        of_vertices, of_faces = _mesh_colors(piece)
        coordinates = getattr(piece.visual, "uv", None)  # a piece without them has no image
        material = None if coordinates is None else getattr(piece.visual, "material", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        vertex_color.append(of_vertices)
        face_color.append(of_faces)
        uv.append(np.zeros((len(piece.vertices), 2)) if coordinates is None else np.asarray(coordinates, float)[:, :2])
        texture.append(np.full(len(piece.faces), -1 if image is None else len(images)))
        images += [] if image is None else [np.asarray(image.convert("RGB"), dtype=np.uint8)]
    color = np.concatenate(vertex_color)[faces] * np.concatenate(face_color)[:, None]
    return MeshAppearance(
        color=color.astype(np.float32),
        uv=np.concatenate(uv)[faces].astype(np.float32),
        texture=np.concatenate(texture).astype(np.int32),
        images=tuple(images),
    )


def _mesh_colors(piece: "trimesh.Trimesh") -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the colours of vertices (V, 3) and triangles (F, 3), whose product is the surface's colour."""
    from trimesh.visual import ColorVisuals, TextureVisuals

    of_vertices, of_faces = np.ones((len(piece.vertices), 3)), np.ones((len(piece.faces), 3))
    visual = piece.visual
    if isinstance(visual, TextureVisuals):
        of_faces = of_faces * _base_color(visual.material)
        painted = visual.vertex_attributes.data.get("color")
        if painted is not None:
            of_vertices = _color_shares(painted)
    elif isinstance(visual, ColorVisuals) and visual.kind == "vertex":
        of_vertices = _color_shares(visual.vertex_colors)
    elif isinstance(visual, ColorVisuals) and visual.kind == "face":
        of_faces = _color_shares(visual.face_colors)
    else:
        of_faces = of_faces * DEFAULT_COLORS["mesh"]
    return of_vertices, of_faces


def _color_shares(colors: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return red, green, blue (N, 3) in 0 to 1 of colours (N, 3) or (N, 4): 0 to 255 if they are bytes."""
    values = np.asarray(colors)
    return values[:, :3].astype(np.float64) / (255.0 if values.dtype == np.uint8 else 1.0)


def _base_color(material: object) -> NDArray[np.float64]:
    """Return the base colour of a material (red, green, blue), which multiplies its image."""
    value = getattr(material, "baseColorFactor", None)  # of GLB and other files with physically based materials
    if value is None:
        value = getattr(material, "kwargs", {}).get("kd")  # of MTL files; trimesh calls a missing one grey
    if value is not None:
        return _color_shares(np.atleast_2d(value))[0]
    painted = any(getattr(material, name, None) is not None for name in ("image", "baseColorTexture"))
    return np.ones(3) if painted else np.asarray(DEFAULT_COLORS["mesh"])


class AppearanceTable:
    """Builder of the arrays of ``AppearanceArrays``, shape by shape."""

    def __init__(self) -> None:
        """Begin with no shape."""
        self._rows: list[tuple[Vec3, Vec3, float, int]] = []
        self._meshes: list[MeshAppearance] = []
        self._first: dict[int, int] = {}
        self._num_faces = 0

    def add(self, cfg: ShapeCfg, *, inherited: Vec3 | None, mesh: MeshAppearance | None) -> None:
        """Append a shape that is no compound, with the colour of its compound, if any, and the colours of its file."""
        given = cfg.color or inherited
        checker = cfg.checker
        first = int(NO_ENTRY)
        if mesh is not None and given is None:
            first = self._first.setdefault(id(mesh), self._num_faces)
            if first == self._num_faces:
                self._meshes.append(mesh)
                self._num_faces += len(mesh.texture)
        color = given or DEFAULT_COLORS[cfg.kind]
        self._rows.append((color, checker.color if checker else color, checker.size if checker else 0.0, first))

    def arrays(self, device: wp.Device) -> AppearanceArrays:
        """Return the arrays on a device."""
        rows = np.zeros(len(self._rows), dtype=Appearance.numpy_dtype())  # type: ignore[call-overload]
        for row, (color, checker_color, size, first) in zip(rows, self._rows, strict=True):
            row["color"], row["checker_color"] = color, checker_color
            row["checker_size"], row["first_face"] = size, first
        looks = AppearanceArrays()
        looks.shape = wp.array(rows, dtype=Appearance, device=device)
        looks.corner_color = _concatenate([m.color.reshape(-1, 3) for m in self._meshes], wp.vec3, device)
        looks.corner_uv = _concatenate([m.uv.reshape(-1, 2) for m in self._meshes], wp.vec2, device)
        images = [image for mesh in self._meshes for image in mesh.images]
        counts = np.cumsum([0, *(len(mesh.images) for mesh in self._meshes)])
        face_textures = [np.where(m.texture < 0, -1, m.texture + n) for m, n in zip(self._meshes, counts, strict=False)]
        looks.face_texture = _concatenate(face_textures, wp.int32, device)
        first = np.cumsum([0, *(image.shape[0] * image.shape[1] for image in images)])
        table = np.zeros(len(images), dtype=Texture.numpy_dtype())  # type: ignore[call-overload]
        for row, image, start in zip(table, images, first, strict=False):
            row["first"], row["height"], row["width"] = start, image.shape[0], image.shape[1]
        looks.textures = wp.array(table, dtype=Texture, device=device)
        looks.texels = _concatenate([image.reshape(-1, 3) for image in images], wp.vec3ub, device)
        return looks


def _concatenate(pieces: Sequence[np.ndarray], dtype: type, device: wp.Device) -> wp.array:
    """Return the rows of all pieces as one array, which may be empty."""
    return wp.array(np.concatenate(pieces) if pieces else [], dtype=dtype, device=device)
