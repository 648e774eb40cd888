"""Collision shapes of a robot.

Frames: body is x forward, y left, z up. A shape on a link of a robot that bends is where it is in the reference pose.
"""

from dataclasses import dataclass

from aerial_gym.config.checks import Vec3, require, require_angles, require_finite, require_positive
from aerial_gym.config.shape import BASE, PartCfg, ShapeCfg


@dataclass(frozen=True, kw_only=True)
class SphereCfg:
    """A collision sphere."""

    center: Vec3  # From the body origin [m], body axes
    radius: float  # Radius [m], > 0
    link: str = BASE  # For robots with joints: the carrier, `base` or the joint whose link carries it

    def __post_init__(self) -> None:
        require_finite(self, "center")
        require_positive(self, "radius")


@dataclass(frozen=True, kw_only=True)
class BoxCfg:
    """A collision box."""

    center: Vec3 = (0.0, 0.0, 0.0)  # From the body origin [m], body axes
    size: Vec3  # Edge lengths [m], each > 0
    euler: Vec3 = (0.0, 0.0, 0.0)  # ZYX roll, pitch, yaw from body to box [rad], within +-2 pi
    link: str = BASE  # For robots with joints: the carrier, `base` or the joint whose link carries it

    def __post_init__(self) -> None:
        require_finite(self, "center", "size")
        require_angles(self, "euler")
        require(self, "size", min(self.size) > 0.0, "every edge must be > 0")


@dataclass(frozen=True, kw_only=True)
class CapsuleCfg:
    """A collision capsule: all points within ``radius`` of a line along its own z."""

    center: Vec3 = (0.0, 0.0, 0.0)  # Of the line, from the body origin [m], body axes
    radius: float  # Radius [m], > 0
    height: float  # Length of the line [m], > 0; the capsule is longer by twice its radius
    euler: Vec3 = (0.0, 0.0, 0.0)  # ZYX roll, pitch, yaw from body to capsule [rad], within +-2 pi
    link: str = BASE  # For robots with joints: the carrier, `base` or the joint whose link carries it

    def __post_init__(self) -> None:
        require_finite(self, "center")
        require_angles(self, "euler")
        require_positive(self, "radius", "height")


CollisionShape = SphereCfg | BoxCfg | CapsuleCfg


@dataclass(frozen=True, kw_only=True)
class CollisionCfg:
    """Collision and landing shapes of a robot, as their union."""

    spheres: tuple[SphereCfg, ...] = ()  # Spheres; a vehicle that lands on one rolls
    boxes: tuple[BoxCfg, ...] = ()  # Boxes: corners touch surfaces, and also the deepest point touches obstacles
    capsules: tuple[CapsuleCfg, ...] = ()  # Capsules, such as skids, arms and rods

    between_links: bool = False
    """Whether links of a robot with joints collide with each other too: every two shapes on different links but those whose
    links a joint connects (links without shapes between are passed over), and those that touch in the reference pose."""

    source: str  # Source of the numbers

    def link_shapes(self, link: str) -> tuple[CollisionShape, ...]:
        """Return the shapes on a link."""
        return tuple(shape for shape in self.shapes if shape.link == link)

    @property
    def shapes(self) -> tuple[CollisionShape, ...]:
        """All shapes."""
        return (*self.spheres, *self.boxes, *self.capsules)

    @property
    def parts(self) -> tuple[PartCfg, ...]:
        """All shapes as visible parts, in the order of ``shapes``."""
        return tuple(_shape_part(shape) for shape in self.shapes)


def _shape_part(own: CollisionShape) -> PartCfg:
    if isinstance(own, SphereCfg):
        return PartCfg(shape=ShapeCfg(kind="sphere", radius=own.radius), position=own.center, link=own.link)
    if isinstance(own, BoxCfg):
        shape = ShapeCfg(kind="box", size=own.size)
    else:
        shape = ShapeCfg(kind="capsule", radius=own.radius, height=own.height)
    return PartCfg(shape=shape, position=own.center, euler=own.euler, link=own.link)
