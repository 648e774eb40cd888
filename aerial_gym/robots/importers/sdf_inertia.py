"""Mass and inertia of SDF links: as given, by the defaults of the format, or from collision shapes and their densities.

Without <inertial>, or for its missing values, a link has 1 kg and 1 kg m² about each axis. With
``auto="true"`` each collision shape is a solid of its own <density>, else that of the inertial, else 1000 kg/m³; a given mass
then scales the whole.

Numbers in ``auto_inertia_params`` are for calculators of meshes that users bring along; they are not read.

Source: sdformat, inertial.sdf and collision.sdf (1.11); Link.cc (``ResolveAutoInertials``); Migration.md, "libsdformat 15.1.1
to 15.2.0" (mass). Solids: Goldstein (1980), Classical Mechanics, chapter 5.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from aerial_gym.assets import load_mesh
from aerial_gym.assets.mesh_files import is_collada
from aerial_gym.assets.urdf import weld
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.file_vehicle import LinkMass, parse_number, parse_numbers
from aerial_gym.robots.importers.sdf_tree import TRUE, Element, SdfTree

if TYPE_CHECKING:
    import trimesh

WATER = 1000.0  # Density of shapes that give none [kg/m³]

SIZES = {
    "box": ("size",), "sphere": ("radius",), "ellipsoid": ("radii",), "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"), "cone": ("radius", "length"),
}  # fmt: skip
"""Shapes with a volume, and the elements that give their sizes."""

HOLLOW = ("plane", "heightmap", "image")  # Shapes without a volume


@dataclass(frozen=True)
class _Solid:
    """A shape of density 1 kg/m³ in its own frame."""

    volume: float
    center: np.ndarray
    inertia: np.ndarray  # About the centre [m⁵], (3, 3)


def link_weight(tree: SdfTree, link: str) -> LinkMass:
    """Return mass, centre of mass and inertia of a link; the frame is in that of the outermost model."""
    inertial = tree.links[link].find("inertial")
    if inertial is None:
        return LinkMass(mass=1.0, pose=tree.pose(link), inertia=np.eye(3))
    if _is_auto_inertial(inertial):
        return _weight_from_shapes(tree, link, inertial)
    at = f"{tree.where}: inertial of {link}"
    mass = parse_number(inertial.findtext("mass"), 1.0, f"{at}: mass")
    if not mass >= 0.0:
        raise ConfigError(f"{at}: mass = {mass:g} kg: must be >= 0")
    return LinkMass(mass=mass, pose=tree.pose_in_link(inertial, link), inertia=_file_inertia(inertial, at))


def list_ignored_numbers(tree: SdfTree, link: str) -> Iterator[str]:
    """Yield the numbers of a link that SDF ignores."""
    element = tree.links[link]
    inertial = element.find("inertial")
    if inertial is not None and _is_auto_inertial(inertial):
        yield from (f"{tag} of an auto inertial" for tag in ("pose", "inertia") if inertial.find(tag) is not None)
    elif any(element.find(f"{tag}/density") is not None for tag in ("collision", "inertial")):
        yield "density, for the inertial is not auto"


def link_assumptions(tree: SdfTree, link: str) -> Iterator[str]:
    """Yield the numbers of a link that are defaults of SDF."""
    inertial = tree.links[link].find("inertial")
    if inertial is not None and _is_auto_inertial(inertial):
        return
    for tag, value in (("mass", "1 kg"), ("inertia", "1 kg m² about each axis")):
        if inertial is None or inertial.find(tag) is None:
            yield f"{tag} = {value}, the default of SDF"


def _is_auto_inertial(inertial: Element) -> bool:
    return inertial.get("auto", "").strip().lower() in TRUE


def _file_inertia(inertial: Element, at: str) -> np.ndarray:
    own = ElementTree.Element("inertia") if inertial.find("inertia") is None else inertial.find("inertia")
    assert own is not None
    xx, yy, zz = (parse_number(own.findtext(tag), 1.0, f"{at}: {tag}") for tag in ("ixx", "iyy", "izz"))
    xy, xz, yz = (parse_number(own.findtext(tag), 0.0, f"{at}: {tag}") for tag in ("ixy", "ixz", "iyz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _weight_from_shapes(tree: SdfTree, link: str, inertial: Element) -> LinkMass:
    at = f"{tree.where}: inertial of {link}"
    common = parse_number(inertial.findtext("density"), WATER, f"{at}: density")
    masses, poses, inertias = [], [], []
    for collision in tree.links[link].findall("collision"):
        solid = _collision_solid(tree, link, collision)
        if solid is None:
            continue
        density = parse_number(collision.findtext("density"), common, f"{at}: density of {collision.get('name')}")
        pose = tree.pose_in_link(collision, link)
        pose[:3, 3] += pose[:3, :3] @ solid.center
        masses.append(density * solid.volume)
        poses.append(pose)
        inertias.append(density * solid.inertia)
    if not sum(masses) > 0.0:
        raise ConfigError(f"{at}: auto needs a collision with volume and density > 0. Give one, or mass and inertia")
    body = weld(masses, poses, inertias)
    share = parse_number(inertial.findtext("mass"), body.mass, f"{at}: mass") / body.mass
    pose = np.eye(4)
    pose[:3, 3] = body.com
    return LinkMass(mass=share * body.mass, pose=pose, inertia=share * body.inertia)


def collision_shape(collision: Element) -> Element | None:
    """Return the shape of a collision, or None."""
    return next(iter(collision.find("geometry") or ()), None)


def shape_lengths(shape: Element, at: str) -> list[float]:
    """Return sizes of a shape [m], one after the other; ``size`` and ``radii`` have three."""
    sizes: list[float] = []
    for tag in SIZES[shape.tag]:
        sizes += parse_numbers(shape.findtext(tag), 3 if tag in ("size", "radii") else 1, f"{at}: {tag}")
    return sizes


def _collision_solid(tree: SdfTree, link: str, collision: Element) -> _Solid | None:
    shape, at = collision_shape(collision), f"{tree.where}: collision of {link}"
    kind = "none" if shape is None else shape.tag
    if shape is None or kind in HOLLOW:
        return None
    if kind == "mesh":
        return _mesh_solid(load_collision_mesh(tree, link, shape), at)
    if kind not in _SOLIDS:
        raise ConfigError(f"{at}: auto cannot weigh a {kind}: give {', '.join(_SOLIDS)}, mesh, or mass and inertia")
    return _SOLIDS[kind](*shape_lengths(shape, at))


def load_collision_mesh(tree: SdfTree, link: str, shape: Element) -> "trimesh.Trimesh":
    """Return the mesh of a collision, scaled [m]; raise ``ConfigError`` if it is missing or a submesh."""
    at = f"{tree.where}: mesh of {link}"
    if shape.find("submesh") is not None:
        raise ConfigError(f"{at}: a submesh is not read. Give the file of that part alone")
    file = tree.mesh_file((shape.findtext("uri") or "").strip(), link)
    mesh = load_mesh(file, scale=1.0, up="z" if is_collada(file) else None)
    mesh.apply_transform(np.diag([*parse_numbers(shape.findtext("scale") or "1 1 1", 3, f"{at}: scale"), 1.0]))
    return mesh


def _mesh_solid(mesh: "trimesh.Trimesh", at: str) -> _Solid:
    mesh.merge_vertices()
    if not mesh.is_watertight:
        raise ConfigError(f"{at}: the mesh is not closed, so that it has no volume. Close it, or give mass and inertia")
    of = mesh.mass_properties
    sign = 1.0 if of.volume > 0.0 else -1.0
    return _Solid(sign * of.volume, np.asarray(of.center_mass), sign * np.asarray(of.inertia))


def _make_solid(volume: float, across: float, other: float, along: float, height: float = 0.0) -> _Solid:
    """Return a solid with its centre at a height, from its moments per volume [m²] about the centre's axes."""
    return _Solid(volume, np.array([0.0, 0.0, height]), volume * np.diag([across, other, along]))


def _solid_ellipsoid(a: float, b: float, c: float) -> _Solid:
    return _make_solid(4.0 / 3.0 * pi * a * b * c, (b * b + c * c) / 5.0, (a * a + c * c) / 5.0, (a * a + b * b) / 5.0)


def _solid_sphere(radius: float) -> _Solid:
    return _solid_ellipsoid(radius, radius, radius)


def _solid_cylinder(radius: float, length: float) -> _Solid:
    across = (3.0 * radius**2 + length**2) / 12.0
    return _make_solid(pi * radius**2 * length, across, across, 0.5 * radius**2)


def _solid_cone(radius: float, length: float) -> _Solid:
    across = 3.0 / 80.0 * (4.0 * radius**2 + length**2)
    return _make_solid(pi * radius**2 * length / 3.0, across, across, 0.3 * radius**2, -0.25 * length)


def _solid_capsule(radius: float, length: float) -> _Solid:
    """Return a cylinder between two half spheres, whose centres are 3/8 of the radius beyond its ends."""
    rod, ball = _solid_cylinder(radius, length), _solid_sphere(radius)
    lever = 0.5 * length + 0.375 * radius
    half = 83.0 / 320.0 * radius**2 * ball.volume  # across, of both halves about their own centres
    across = rod.inertia[0, 0] + half + ball.volume * lever**2
    along = rod.inertia[2, 2] + ball.inertia[2, 2]
    return _Solid(rod.volume + ball.volume, np.zeros(3), np.diag([across, across, along]))


_SOLIDS = {
    "box": lambda x, y, z: _make_solid(x * y * z, (y**2 + z**2) / 12.0, (x**2 + z**2) / 12.0, (x**2 + y**2) / 12.0),
    "sphere": _solid_sphere, "ellipsoid": _solid_ellipsoid, "cylinder": _solid_cylinder,
    "capsule": _solid_capsule, "cone": _solid_cone,
}  # fmt: skip
