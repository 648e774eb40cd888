"""What obstacles are made of: primitives, meshes, URDF files, compounds of them, and families of such shapes.

Frames: each shape's own, z up; lengths in metres, angles in radians.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, pi

from aerial_gym.config.robot import Vec3, require_finite
from aerial_gym.errors import ConfigError

FIRST_INSTANCE_ID = 100
"""Instance ids start here, so that the semantic ids 0 to 99 never meet one. Source: parity with Aerial Gym (3.5)."""

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
    """What segmentation shows for this part; the asset's own if not given."""

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
    """What a compound consists of; at least one."""

    color: Vec3 = (0.7, 0.7, 0.7)
    """Red, green, blue of its surface as colour cameras see it, each 0 to 1; parts of a compound have their own."""

    scale: float = 1.0
    """Factor on the coordinates of a mesh, > 0; 1 for every other kind."""

    link_ids: Mapping[str, int] | None = None
    """What segmentation shows for named links of a URDF, 0 to 99; every name must be one of its links."""

    first_link_id: int | None = None
    """The other links of a URDF count up from here; if not given, they show what the asset shows."""

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
        if not all(0.0 <= share <= 1.0 for share in self.color):
            raise ConfigError(f"ShapeCfg.color = {self.color!r}: red, green and blue must lie in 0 to 1")
        if self.parts == ():
            raise ConfigError("ShapeCfg.parts: a compound needs at least one part")
        if not 0.0 < self.scale < inf:
            raise ConfigError(f"ShapeCfg.scale = {self.scale!r}: must be > 0 and finite")
        if self.scale != 1.0 and self.kind != "mesh":
            raise ConfigError(
                f"ShapeCfg.scale = {self.scale!r}: only a mesh is scaled; change the size of a {self.kind}"
            )
        if self.kind != "urdf" and (self.link_ids or self.first_link_id is not None):
            raise ConfigError(f"ShapeCfg.link_ids, first_link_id: a {self.kind} has no links; only a urdf has")
        for link, semantic_id in (*(self.link_ids or {}).items(), ("first_link_id", self.first_link_id or 0)):
            if not 0 <= semantic_id < FIRST_INSTANCE_ID:
                raise ConfigError(f"ShapeCfg: {link} = {semantic_id!r} must be 0 to {FIRST_INSTANCE_ID - 1}")


@dataclass(frozen=True, kw_only=True)
class FamilyCfg:
    """Shapes made by a rule from a seed: see ``aerial_gym.assets.families`` for the rules and their numbers."""

    name: str
    """Which family."""

    variants: int
    """Number of different shapes, >= 1; the first n of them do not depend on this number."""

    seed: int = 0
    """Same seed, same shapes; >= 0."""

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest value of numbers that shall differ from the family's own."""

    def __post_init__(self) -> None:
        if self.variants < 1:
            raise ConfigError(f"FamilyCfg {self.name!r}: variants = {self.variants!r} must be >= 1")
        if self.seed < 0:
            raise ConfigError(f"FamilyCfg {self.name!r}: seed = {self.seed!r} must be >= 0")
        for name, (low, high) in self.ranges.items():
            if not 0.0 <= low <= high < inf:
                raise ConfigError(f"FamilyCfg {self.name!r}: {name} = {(low, high)!r} needs 0 <= low <= high < inf")
