"""URDF files as compounds, one part for every geometry of every link, and as one rigid body; joints fixed at zero.

Frames: axes and origin of the root link; z up, SI units. Letters: L links.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from aerial_gym.assets.mesh_files import is_collada
from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.config.robot import Vec3
from aerial_gym.errors import ConfigError
from aerial_gym.extras import optional_import

if TYPE_CHECKING:
    from yourdfpy import URDF
    from yourdfpy.urdf import Geometry, Joint, Link, Material

PACKAGE_LEVELS = 2  # Folders above a URDF in which packages are looked for: its package, and their folder
MAX_LINKS = 10_000  # Of a URDF; a tree of links is walked one by one

_JOINTS = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")


def load_urdf_shape(shape: ShapeCfg) -> ShapeCfg:
    """Return the compound of a shape of kind ``urdf``; links without a material have its colour."""
    compound = load_urdf(str(shape.path), link_ids=shape.link_ids or {}, first_link_id=shape.first_link_id)
    return replace(compound, color=shape.color)


def load_urdf(
    path: str | Path, *, link_ids: Mapping[str, int] | None = None, first_link_id: int | None = None
) -> ShapeCfg:
    """Return a URDF as a compound of the collision geometries of its links, or the visual ones of a link without them.

    Args:
        link_ids: Semantic ids of named links, 0 to 99.
        first_link_id: Semantic id of the first other link; the rest count up in the order of the file. None gives them that of
            the asset.

    Raises:
        ConfigError: If the file, a mesh or yourdfpy is missing; if the file is no URDF, or has no geometry; if a number is
            impossible, or a named link missing. The message names the file and the link.
    """
    robot, link_ids = read_urdf(path), link_ids or {}
    for name in link_ids:
        if name not in robot.link_map:
            raise ConfigError(f"URDF {path}: there is no link {name!r}. Known: {', '.join(robot.link_map)}")
    parts: list[PartCfg] = []
    poses = link_poses(robot)
    counted = {name: i for i, name in enumerate(name for name in robot.link_map if name not in link_ids)}
    for name, link in robot.link_map.items():
        own = None if first_link_id is None or name in link_ids else first_link_id + counted[name]
        to_root = poses[name]
        try:
            bodies = link.collisions or link.visuals
            colors = _geometry_colors(robot, link, count=len(bodies))
            for body, color in zip(bodies, colors, strict=True):
                pose = to_root if body.origin is None else to_root @ body.origin
                parts.append(
                    _part_cfg(body.geometry, pose, link_ids.get(name, own), color, Path(path).resolve().parent)
                )
        except ConfigError as error:
            raise ConfigError(f"URDF {path}: link {name!r}: {error}") from None
    if not parts:
        raise ConfigError(f"URDF {path}: holds no geometry")
    return ShapeCfg(kind="compound", parts=tuple(parts))


def link_poses(robot: "URDF") -> dict[str, np.ndarray]:
    """Return the pose of each link in the root frame, (4, 4), with all joints at zero and mimics at their offsets."""
    below: dict[str, list[Joint]] = {}
    for joint in robot.joint_map.values():
        below.setdefault(joint.parent, []).append(joint)
    children = {joint.child for joint in robot.joint_map.values()}
    waiting = [name for name in robot.link_map if name not in children]
    poses = {name: np.eye(4) for name in waiting}
    while waiting:
        name = waiting.pop()
        for joint in below.get(name, []):
            poses[joint.child] = poses[name] @ _joint_frame_at_zero(joint)
            waiting.append(joint.child)
    return poses


def _joint_frame_at_zero(joint: "Joint") -> np.ndarray:
    """Return the child link's frame in that of its parent, (4, 4)."""
    from trimesh.transformations import rotation_matrix, translation_matrix

    origin = np.eye(4) if joint.origin is None else joint.origin
    if joint.mimic is None or joint.type not in ("revolute", "continuous", "prismatic"):
        return origin
    offset = float(joint.mimic.offset or 0.0)
    if joint.type == "prismatic":
        return origin @ translation_matrix(offset * np.asarray(joint.axis))
    return origin @ rotation_matrix(offset, joint.axis)


def _geometry_colors(robot: "URDF", link: "Link", *, count: int) -> list[Vec3 | None]:
    """Return the colours of ``count`` geometries of a link: of their own visuals, or of the first visual that has one.

    Collision geometries have no materials; where a link has as many visuals, they are taken to be the same in order.
    """
    colors = [_material_color(robot, visual.material) for visual in link.visuals]
    if len(colors) == count:
        return colors
    return [next((color for color in colors if color is not None), None)] * count


def _material_color(robot: "URDF", material: "Material | None") -> Vec3 | None:
    """Return the colour of a material, which may stand at the top of the file and be named only; None without one."""
    if material is None:
        return None
    named = {other.name: other for other in robot.robot.materials}
    color = material.color or (named[material.name].color if material.name in named else None)
    if color is None:
        return None
    rgba = np.asarray(color.rgba, dtype=float)
    if rgba.shape != (4,) or not ((rgba >= 0.0) & (rgba <= 1.0)).all():
        raise ConfigError(f"material {material.name!r}: rgba {rgba.tolist()} must be four numbers from 0 to 1")
    return float(rgba[0]), float(rgba[1]), float(rgba[2])


def read_urdf(path: str | Path) -> "URDF":
    """Return the parsed file without meshes, joints at zero; raise ``ConfigError`` unless the links are a tree."""
    with optional_import(f"URDF {path}"):
        import yourdfpy
    if not Path(path).is_file():
        raise ConfigError(f"URDF {path}: no such file")
    try:
        root = ElementTree.parse(path).getroot()  # yourdfpy mends broken XML in silence
    except ElementTree.ParseError as error:
        raise ConfigError(f"URDF {path}: not valid XML ({error})") from None
    if root.tag != "robot" or root.find("link") is None:
        raise ConfigError(f"URDF {path}: must hold a <robot> with at least one <link>")
    try:
        _check_tree(root)
    except ConfigError as error:
        raise ConfigError(f"URDF {path}: {error}") from None
    try:
        return yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=False)
    except Exception as error:  # yourdfpy raises whatever its parser meets
        raise ConfigError(f"URDF {path}: cannot be read ({error})") from None


def _check_tree(root: ElementTree.Element) -> None:
    """Raise ``ConfigError`` unless the links are a tree; yourdfpy silently drops or joins other links."""
    links = [link.get("name", "") for link in root.findall("link")]
    if len(links) > MAX_LINKS:
        raise ConfigError(f"{len(links)} links; at most {MAX_LINKS} can be read")
    for name, count in Counter(links).items():
        if not name or count > 1:
            raise ConfigError(f"link {name!r}: every link needs a name of its own")
    known, parents = set(links), {}
    for joint in root.findall("joint"):
        kind, ends = joint.get("type"), [joint.find(tag) for tag in ("parent", "child")]
        parent, child = ("" if end is None else end.get("link", "") for end in ends)
        if kind not in _JOINTS:
            raise ConfigError(f"joint {joint.get('name')!r}: type {kind!r} must be one of {', '.join(_JOINTS)}")
        for end in (parent, child):
            if end not in known:
                raise ConfigError(f"joint {joint.get('name')!r}: there is no link {end!r}. Known: {', '.join(links)}")
        if child in parents:
            raise ConfigError(f"link {child!r} has two parents: {parents[child]!r} and {parent!r}")
        parents[child] = parent
    roots = [name for name in links if name not in parents]
    if len(roots) != 1:
        raise ConfigError(f"{len(roots)} links have no parent ({', '.join(roots)}); a tree has one")
    reached, frontier = set(), {roots[0]}
    while frontier:
        reached |= frontier
        frontier = {child for child, parent in parents.items() if parent in frontier}
    if missing := [name for name in links if name not in reached]:
        raise ConfigError(f"link {missing[0]!r} is its own ancestor")


def _part_cfg(
    geometry: "Geometry", pose: np.ndarray, semantic_id: int | None, color: Vec3 | None, folder: Path
) -> PartCfg:
    from trimesh.transformations import euler_from_matrix

    if not np.isfinite(pose).all():
        raise ConfigError("an origin is not finite")
    x, y, z = (float(value) for value in pose[:3, 3])
    roll, pitch, yaw = (float(angle) for angle in euler_from_matrix(pose, "sxyz"))
    shape = replace(_shape_cfg(geometry, folder), color=color)
    return PartCfg(shape=shape, position=(x, y, z), euler=(roll, pitch, yaw), semantic_id=semantic_id)


def _shape_cfg(geometry: "Geometry", folder: Path) -> ShapeCfg:
    if geometry.box is not None:
        x, y, z = (float(edge) for edge in geometry.box.size)
        return ShapeCfg(kind="box", size=(x, y, z))
    if geometry.sphere is not None:
        return ShapeCfg(kind="sphere", radius=float(geometry.sphere.radius))
    if geometry.cylinder is not None:
        return ShapeCfg(kind="cylinder", radius=float(geometry.cylinder.radius), height=float(geometry.cylinder.length))
    if geometry.mesh is None:
        raise ConfigError("a geometry is neither box, sphere, cylinder nor mesh")
    if not geometry.mesh.filename:
        raise ConfigError("a mesh has no filename")
    given = np.asarray(1.0 if geometry.mesh.scale is None else geometry.mesh.scale, dtype=float).reshape(-1)
    if given.size not in (1, 3):
        raise ConfigError(f"mesh {geometry.mesh.filename}: scale {given.tolist()} must be one number, or three")
    scale = np.ones(3) * given
    if np.ptp(scale) != 0.0:
        raise ConfigError(f"mesh {geometry.mesh.filename}: scale {scale.tolist()} differs by axis: scale the file")
    file = _mesh_file(geometry.mesh.filename, folder)
    return ShapeCfg(kind="mesh", path=str(file), scale=float(scale[0]), up="z" if is_collada(file) else None)


def _mesh_file(name: str, folder: Path) -> Path:
    """Return the path of a mesh file: beside the URDF or, for ``package://``, in a folder ``PACKAGE_LEVELS`` above at most.

    A name that leads out of the folder in which it was matched, by ``..`` or by a link, is refused.
    """
    package = name.startswith("package://")
    whole = name.removeprefix("package://").removeprefix("file://")
    tails = [whole, whole.partition("/")[2]] if package else [whole]
    folders = (folder, *folder.parents[: PACKAGE_LEVELS if package else 0])
    bases = [base for base in folders if not package or base.parent != base]
    matches = [(base, base / tail) for base in bases for tail in tails if tail and (base / tail).is_file()]
    if not matches:
        raise ConfigError(f"mesh {name}: no such file")
    base, file = matches[0]
    if package and not file.resolve().is_relative_to(base):
        raise ConfigError(f"mesh {name}: leads out of the folder {base}. Copy the file beside the URDF")
    return file


@dataclass(frozen=True)
class RigidBody:
    """Mass, centre of mass and inertia of a rigid body."""

    mass: float  # [kg]
    com: np.ndarray  # Centre of mass from the origin of the root link [m], (3,)
    inertia: np.ndarray  # About the centre of mass, axes of the root link [kg m²], (3, 3)


def weld(masses: Sequence[float], poses: Sequence[np.ndarray], inertias: Sequence[np.ndarray]) -> RigidBody:
    """Combine links into one body by the parallel axis theorem.

    Args:
        poses: Poses of their inertia frames, with the centre of mass as origin, in the root frame, (4, 4) each.

    Source:
        Derived: ``J = sum R_i J_i R_i^T + m_i (|r_i|² 1 - r_i r_i^T)`` with r_i from the common centre of mass.
    """
    places, weights = np.array([pose[:3, 3] for pose in poses]), np.array(masses)
    com = weights @ places / weights.sum()
    inertia = np.zeros((3, 3))
    for own, pose, mass, place in zip(inertias, poses, masses, places, strict=True):
        turn, arm = pose[:3, :3], place - com
        inertia += turn @ own @ turn.T + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return RigidBody(float(weights.sum()), com, 0.5 * (inertia + inertia.T))


def urdf_body(path: str | Path) -> RigidBody:
    """Return the links of a URDF as one body; raise ``ConfigError`` if no link has a mass."""
    robot = read_urdf(path)
    at = link_poses(robot)
    links = [(link.inertial, at[name]) for name, link in robot.link_map.items() if link.inertial is not None]
    masses = [inertial.mass or 0.0 for inertial, _ in links]
    if not sum(masses) > 0.0:
        raise ConfigError(f"URDF {path}: no link has a mass")
    poses = [pose if inertial.origin is None else pose @ inertial.origin for inertial, pose in links]
    none = np.zeros((3, 3))
    return weld(masses, poses, [none if i.inertia is None else np.asarray(i.inertia, dtype=float) for i, _ in links])
