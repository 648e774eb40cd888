"""Triangles of shapes for the page, in each shape's own frame: z up, metres."""

from typing import TYPE_CHECKING

import numpy as np
import torch

from aerial_gym.assets.appearance import DEFAULT_COLORS
from aerial_gym.assets.mesh_files import load_mesh
from aerial_gym.config.checks import Vec3
from aerial_gym.config.shape import PartCfg, ShapeCfg
from aerial_gym.math.quaternion import quat_from_euler, quat_to_matrix

if TYPE_CHECKING:
    import trimesh

PLANE_M = 200.0  # Edge of the square that stands for an endless plane [m]


def shape_mesh(shape: ShapeCfg) -> "trimesh.Trimesh":
    """Return the triangles of one shape, which is no compound and no URDF."""
    import trimesh.creation as make

    radius, height = shape.radius or 0.0, shape.height or 0.0
    if shape.kind == "mesh":
        return load_mesh(str(shape.path), scale=shape.scale, up=shape.up)
    if shape.kind == "sphere":
        return make.icosphere(subdivisions=2, radius=radius)
    if shape.kind == "cylinder":
        return make.cylinder(radius=radius, height=height, sections=24)
    if shape.kind == "capsule":
        return make.capsule(radius=radius, height=height, count=[16, 16])
    if shape.kind == "plane":
        sheet = make.box(extents=(PLANE_M, PLANE_M, 0.01))
        return sheet.apply_translation((0.0, 0.0, -0.005))
    return make.box(extents=shape.size)


def part_mesh(part: PartCfg) -> "trimesh.Trimesh":
    """Return the triangles of a part in the frame of its compound or link."""
    transform = np.eye(4)
    transform[:3, :3] = quat_to_matrix(quat_from_euler(torch.tensor(part.euler, dtype=torch.float64))).numpy()
    transform[:3, 3] = part.position
    return shape_mesh(part.shape).apply_transform(transform)


def rgb(shape: ShapeCfg, inherited: Vec3 | None = None) -> tuple[int, int, int]:
    """Return the colour of a shape as three numbers from 0 to 255."""
    red, green, blue = shape.color or inherited or DEFAULT_COLORS[shape.kind]
    return round(255 * red), round(255 * green), round(255 * blue)
