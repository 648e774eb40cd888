"""Shapes of obstacles: primitives, meshes, URDF files, compounds of them, and families of such shapes.

Frames: each shape's own, z up; lengths in metres, angles in radians.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path

from aerial_gym.config import checks
from aerial_gym.config.checks import MAX_MADE, Vec3
from aerial_gym.errors import ConfigError

FIRST_INSTANCE_ID = 100  # First instance id, beyond semantic ids 0 to 99. Source: parity with Aerial Gym (3.5)
ROBOT_ID = 0  # Segmentation id of a visible robot. Source: parity with Aerial Gym (3.5)
GROUND_ID = 15  # Segmentation id of the ground: the first after those of the walls, 9 to 14 (parity 2.2)
BASE = "base"  # Name of the link of a robot that is no joint's: the body itself

_FIELDS_OF_KIND = {
    "box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "height"), "capsule": ("radius", "height"),
    "plane": (), "mesh": ("path",), "compound": ("parts",), "urdf": ("path",),
}  # fmt: skip


def require_color(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named colours, where they are given, are red, green and blue in 0 to 1."""
    for name in names:
        holds = all(0.0 <= share <= 1.0 for share in getattr(config, name) or ())
        checks.require(config, name, holds, "red, green and blue must lie in 0 to 1")


def require_id(config: object, name: str) -> None:
    """Raise ``ConfigError`` unless a semantic id, where it is given, is below the ids of instances."""
    holds = 0 <= (getattr(config, name) or 0) < FIRST_INSTANCE_ID
    checks.require(config, name, holds, f"must be 0 to {FIRST_INSTANCE_ID - 1}")


@dataclass(frozen=True, kw_only=True)
class CheckerCfg:
    """Fields of a second colour, as in a chessboard: a texture that shows how a camera moves.

    The board is solid: cubes of two colours fill the frame of the shape, with a common corner at its origin. The surface
    has the colour of the cube 1 % of a field below it, so that faces may lie between cubes. It moves
    and turns with the shape. Each pixel shows the field that its ray meets; far fields are not blurred.
    """

    size: float  # Edge of a field [m], > 0
    color: Vec3 = (0.25, 0.25, 0.25)  # Red, green, blue of every second field, each 0 to 1

    def __post_init__(self) -> None:
        checks.require_positive(self, "size")
        require_color(self, "color")


@dataclass(frozen=True, kw_only=True)
class PartCfg:
    """A shape at its place in a compound: a link of a URDF, a branch of a tree."""

    shape: "ShapeCfg"  # A shape that is one body: anything but a compound or a URDF
    position: Vec3 = (0.0, 0.0, 0.0)  # Of the shape's origin in the frame of the compound [m]
    euler: Vec3 = (0.0, 0.0, 0.0)  # ZYX roll, pitch, yaw from the compound to the shape [rad], within +-2 pi
    semantic_id: int | None = None  # Segmentation id of this part; the asset's own if not given
    link: str = BASE  # For robots with joints: the joint whose link carries it; pose in body axes, reference pose

    def __post_init__(self) -> None:
        if self.shape.kind in ("compound", "urdf"):
            raise ConfigError(f"PartCfg.shape: a compound cannot hold a {self.shape.kind}; list all its parts")
        checks.require_finite(self, "position")
        checks.require_angles(self, "euler")
        require_id(self, "semantic_id")


@dataclass(frozen=True, kw_only=True)
class ShapeCfg:
    """A rigid shape in its own frame: centred on the origin, axis of symmetry along z; a mesh keeps its own origin."""

    kind: str
    """``box`` (needs size), ``sphere`` (radius), ``cylinder`` and ``capsule`` (radius, height), ``plane`` (nothing; solid
    below its z = 0, without end), ``mesh`` (path), ``compound`` (parts), ``urdf`` (path: every link becomes a part,
    joints at zero)."""

    size: Vec3 | None = None  # Edge lengths of a box [m], each > 0
    radius: float | None = None  # Radius [m], > 0
    height: float | None = None  # Length of the cylindrical part along z [m], > 0; a capsule adds twice its radius
    path: str | None = None  # Mesh file for trimesh, or URDF; `load_environment` counts from the environment's own file
    parts: tuple[PartCfg, ...] | None = None  # Parts of a compound; at least one

    color: Vec3 | None = None
    """Red, green, blue of its surface as colour cameras see it, each 0 to 1. If not given: a mesh has the colours of its
    file (vertices, faces, textures, materials), a part of a compound those of the compound, and a link of a URDF that of
    its material. Other shapes have a plain colour of their kind. A given one replaces the colours of a mesh file; that of
    a compound or a URDF is for the parts and links without one."""

    checker: CheckerCfg | None = None
    """Fields of a second colour, in the shape's own frame; a compound and a URDF have none, but their parts may."""

    scale: float = 1.0  # Factor on the coordinates of a mesh, > 0; 1 for every other kind

    up: str | None = None
    """Axis of the mesh file that points up: ``x``, ``y`` or ``z``. If not given: ``y`` of a glTF file, what a Collada file
    says (in a URDF ``z``, as RViz, MoveIt and Gazebo take it), and ``z`` of all other files."""

    link_ids: Mapping[str, int] | None = None  # Segmentation ids of named links of a URDF, 0 to 99
    first_link_id: int | None = None  # First id of other links of a URDF, counting up; if not given, the asset's

    def __post_init__(self) -> None:
        checks.require_choice(self, "kind", _FIELDS_OF_KIND)
        needed = _FIELDS_OF_KIND[self.kind]
        for name in ("size", "radius", "height", "path", "parts"):
            value = getattr(self, name)
            checks.require(self, name, name not in needed or value is not None, f"a {self.kind} needs it")
            rule = f"a {self.kind} has none. It needs {', '.join(needed) or 'nothing'}"
            checks.require(self, name, name in needed or value is None, rule)
            for length in value if isinstance(value, tuple) else (value,):
                holds = not isinstance(length, (int, float)) or 0.0 < length < inf
                checks.require(self, name, holds, "must be > 0 and finite")
        require_color(self, "color")
        holds = self.checker is None or self.kind not in ("compound", "urdf")
        checks.require(self, "checker", holds, f"a {self.kind} has none; give it to its parts")
        checks.require(self, "parts", self.parts != (), "a compound needs at least one part")
        for part in self.parts or ():
            if part.link != BASE:
                raise ConfigError(f"ShapeCfg.parts: a part on link {part.link!r}: only a robot has links that move")
        checks.require_positive(self, "scale")
        is_mesh, is_urdf = self.kind == "mesh", self.kind == "urdf"
        checks.require(self, "scale", is_mesh or self.scale == 1.0, "only a mesh is scaled: change size")
        checks.require(self, "up", self.up in (None, "x", "y", "z"), "must be x, y or z")
        checks.require(self, "up", is_mesh or self.up is None, f"only a mesh has an up axis: turn the {self.kind}")
        checks.require(self, "link_ids", is_urdf or not self.link_ids, f"a {self.kind} has no links; only a urdf has")
        checks.require(
            self, "first_link_id", is_urdf or self.first_link_id is None, f"a {self.kind} has no links; only a urdf has"
        )
        require_id(self, "first_link_id")
        holds = all(0 <= number < FIRST_INSTANCE_ID for number in (self.link_ids or {}).values())
        checks.require(self, "link_ids", holds, f"must be 0 to {FIRST_INSTANCE_ID - 1}")


@dataclass(frozen=True, kw_only=True)
class FamilyCfg:
    """Shapes made by a rule from a seed: see ``aerial_gym.assets.families`` for the rules and their numbers."""

    name: str  # Name of the family
    variants: int  # Number of different shapes, >= 1; the first n of them do not depend on this number
    seed: int = 0  # Same seed, same shapes; >= 0

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest value of numbers that shall differ from the family's own."""

    def __post_init__(self) -> None:
        checks.require_count(self, "variants", most=MAX_MADE)
        checks.require(self, "seed", self.seed >= 0, "must be >= 0")
        for name, (low, high) in self.ranges.items():
            if not 0.0 <= low <= high < inf:
                raise ConfigError(f"FamilyCfg {self.name!r}: {name} = {(low, high)!r} needs 0 <= low <= high < inf")


def absolute_paths(shape: ShapeCfg, folder: Path) -> ShapeCfg:
    """Return a shape with absolute file paths, also of its parts; relative ones count from a folder."""
    if shape.parts:
        parts = tuple(replace(part, shape=absolute_paths(part.shape, folder)) for part in shape.parts)
        return replace(shape, parts=parts)
    return replace(shape, path=str(folder / shape.path)) if shape.path else shape
