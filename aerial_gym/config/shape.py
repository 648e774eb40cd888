"""Shapes of obstacles: primitives, meshes, URDF files, compounds of them, and families of such shapes.

Frames: each shape's own, z up; lengths in metres, angles in radians.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi
from pathlib import Path

from aerial_gym.config.checks import MAX_MADE, Vec3, require_finite, require_positive
from aerial_gym.errors import ConfigError

FIRST_INSTANCE_ID = 100
"""Instance ids start here, so that the semantic ids 0 to 99 never meet one. Source: parity with Aerial Gym (3.5)."""

ROBOT_ID = 0
"""Segmentation id of a visible robot. Source: parity with Aerial Gym (3.5)."""

GROUND_ID = 15
"""Segmentation id of the ground: the first after those of the walls, 9 to 14 (parity 2.2)."""

BASE = "base"
"""Name of the link of a robot that is no joint's: the body itself."""

_FIELDS_OF_KIND = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "height"),
    "capsule": ("radius", "height"),
    "plane": (),
    "mesh": ("path",),
    "compound": ("parts",),
    "urdf": ("path",),
}


def require_color(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named colours, where they are given, are red, green and blue in 0 to 1."""
    for name in names:
        value = getattr(config, name)
        if value is not None and not all(0.0 <= share <= 1.0 for share in value):
            raise ConfigError(f"{type(config).__name__}.{name} = {value!r}: red, green and blue must lie in 0 to 1")


@dataclass(frozen=True, kw_only=True)
class CheckerCfg:
    """Fields of a second colour, as in a chessboard: a texture that shows how a camera moves.

    The board is solid: cubes of two colours fill the frame of the shape, with a common corner at its origin. The surface
    has the colour of the cube 1 % of a field below it, so that faces may lie between cubes. It moves
    and turns with the shape. Each pixel shows the field that its ray meets; far fields are not blurred.
    """

    size: float
    """Edge of a field [m], > 0."""

    color: Vec3 = (0.25, 0.25, 0.25)
    """Red, green, blue of every second field, each 0 to 1."""

    def __post_init__(self) -> None:
        require_positive(self, "size")
        require_color(self, "color")


@dataclass(frozen=True, kw_only=True)
class PartCfg:
    """A shape at its place in a compound: a link of a URDF, a branch of a tree."""

    shape: "ShapeCfg"
    """A shape that is one body: anything but a compound or a URDF."""

    position: Vec3 = (0.0, 0.0, 0.0)
    """Of the shape's origin in the frame of the compound [m]."""

    euler: Vec3 = (0.0, 0.0, 0.0)
    """ZYX roll, pitch, yaw from the compound to the shape [rad], within +-2 pi."""

    semantic_id: int | None = None
    """Segmentation id of this part; the asset's own if not given."""

    link: str = BASE
    """For robots with joints: the joint whose link carries it; its pose is in body axes, in the reference pose."""

    def __post_init__(self) -> None:
        if self.shape.kind in ("compound", "urdf"):
            raise ConfigError(f"PartCfg.shape: a compound cannot hold a {self.shape.kind}; list all its parts")
        require_finite(self, "position", "euler")
        if any(abs(angle) > 2.0 * pi for angle in self.euler):
            raise ConfigError(f"PartCfg.euler = {self.euler!r}: must lie within +-2 pi. Angles are in radians")
        if self.semantic_id is not None and not 0 <= self.semantic_id < FIRST_INSTANCE_ID:
            raise ConfigError(f"PartCfg.semantic_id = {self.semantic_id!r}: must be 0 to {FIRST_INSTANCE_ID - 1}")


@dataclass(frozen=True, kw_only=True)
class ShapeCfg:
    """A rigid shape in its own frame: centred on the origin, axis of symmetry along z; a mesh keeps its own origin."""

    kind: str
    """``box`` (needs size), ``sphere`` (radius), ``cylinder`` and ``capsule`` (radius, height), ``plane`` (nothing; solid
    below its z = 0, without end), ``mesh`` (path), ``compound`` (parts), ``urdf`` (path: every link becomes a part,
    joints at zero)."""

    size: Vec3 | None = None
    """Edge lengths of a box [m], each > 0."""

    radius: float | None = None
    """Radius [m], > 0."""

    height: float | None = None
    """Length of the cylindrical part along z [m], > 0; a capsule is longer by twice its radius."""

    path: str | None = None
    """Mesh file that trimesh reads, or URDF; ``load_environment`` takes it relative to the environment's own file."""

    parts: tuple[PartCfg, ...] | None = None
    """Parts of a compound; at least one."""

    color: Vec3 | None = None
    """Red, green, blue of its surface as colour cameras see it, each 0 to 1. If not given: a mesh has the colours of its
    file (vertices, faces, textures, materials), a part of a compound those of the compound, and a link of a URDF that of
    its material. Other shapes have a plain colour of their kind. A given one replaces the colours of a mesh file; that of
    a compound or a URDF is for the parts and links without one."""

    checker: CheckerCfg | None = None
    """Fields of a second colour, in the shape's own frame; a compound and a URDF have none, but their parts may."""

    scale: float = 1.0
    """Factor on the coordinates of a mesh, > 0; 1 for every other kind."""

    up: str | None = None
    """Axis of the mesh file that points up: ``x``, ``y`` or ``z``. If not given: ``y`` of a glTF file, what a Collada file
    says (in a URDF ``z``, as RViz, MoveIt and Gazebo take it), and ``z`` of all other files."""

    link_ids: Mapping[str, int] | None = None
    """Segmentation ids of named links of a URDF, 0 to 99; every name must be one of its links."""

    first_link_id: int | None = None
    """First id of the other links of a URDF, counting up; if not given, they have the asset's id."""

    def __post_init__(self) -> None:
        if self.kind not in _FIELDS_OF_KIND:
            raise ConfigError(f"ShapeCfg.kind = {self.kind!r}: must be one of {', '.join(_FIELDS_OF_KIND)}")
        needed = _FIELDS_OF_KIND[self.kind]
        for name in ("size", "radius", "height", "path", "parts"):
            value = getattr(self, name)
            if name in needed and value is None:
                raise ConfigError(f"ShapeCfg.{name}: a {self.kind} needs it")
            if name not in needed and value is not None:
                raise ConfigError(
                    f"ShapeCfg.{name} = {value!r}: a {self.kind} has none. It needs {', '.join(needed) or 'nothing'}"
                )
            for length in value if isinstance(value, tuple) else (value,):
                if isinstance(length, (int, float)) and not 0.0 < length < inf:
                    raise ConfigError(f"ShapeCfg.{name} = {value!r}: must be > 0 and finite")
        require_color(self, "color")
        if self.checker is not None and self.kind in ("compound", "urdf"):
            raise ConfigError(f"ShapeCfg.checker: a {self.kind} has none; give it to its parts")
        if self.parts == ():
            raise ConfigError("ShapeCfg.parts: a compound needs at least one part")
        for part in self.parts or ():
            if part.link != BASE:
                raise ConfigError(f"ShapeCfg.parts: a part on link {part.link!r}: only a robot has links that move")
        require_positive(self, "scale")
        if self.scale != 1.0 and self.kind != "mesh":
            raise ConfigError(
                f"ShapeCfg.scale = {self.scale!r}: only a mesh is scaled; change the size of a {self.kind}"
            )
        if self.up not in (None, "x", "y", "z"):
            raise ConfigError(f"ShapeCfg.up = {self.up!r}: must be x, y or z")
        if self.up is not None and self.kind != "mesh":
            raise ConfigError(f"ShapeCfg.up = {self.up!r}: only a mesh file has an up axis; turn a {self.kind} instead")
        if self.kind != "urdf" and (self.link_ids or self.first_link_id is not None):
            raise ConfigError(f"ShapeCfg.link_ids, first_link_id: a {self.kind} has no links; only a urdf has")
        for link, semantic_id in (*(self.link_ids or {}).items(), ("first_link_id", self.first_link_id or 0)):
            if not 0 <= semantic_id < FIRST_INSTANCE_ID:
                raise ConfigError(f"ShapeCfg: {link} = {semantic_id!r} must be 0 to {FIRST_INSTANCE_ID - 1}")


@dataclass(frozen=True, kw_only=True)
class FamilyCfg:
    """Shapes made by a rule from a seed: see ``aerial_gym.assets.families`` for the rules and their numbers."""

    name: str
    """Name of the family."""

    variants: int
    """Number of different shapes, >= 1; the first n of them do not depend on this number."""

    seed: int = 0
    """Same seed, same shapes; >= 0."""

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest value of numbers that shall differ from the family's own."""

    def __post_init__(self) -> None:
        if not 1 <= self.variants <= MAX_MADE:
            raise ConfigError(
                f"FamilyCfg {self.name!r}: variants = {self.variants!r} must be >= 1 and at most {MAX_MADE:,}"
            )
        if self.seed < 0:
            raise ConfigError(f"FamilyCfg {self.name!r}: seed = {self.seed!r} must be >= 0")
        for name, (low, high) in self.ranges.items():
            if not 0.0 <= low <= high < inf:
                raise ConfigError(f"FamilyCfg {self.name!r}: {name} = {(low, high)!r} needs 0 <= low <= high < inf")


def absolute_paths(shape: ShapeCfg, folder: Path) -> ShapeCfg:
    """Return a shape with absolute file paths, also of its parts; relative ones count from a folder."""
    if shape.parts:
        parts = tuple(replace(part, shape=absolute_paths(part.shape, folder)) for part in shape.parts)
        return replace(shape, parts=parts)
    return replace(shape, path=str(folder / shape.path)) if shape.path else shape
