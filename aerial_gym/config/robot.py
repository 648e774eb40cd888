"""Robot files: body, rotors, mounts, collision shapes, initial state, randomisation, sensors, effects.

Frames: body is x forward, y left, z up, with its origin at the point that a log or a motion capture system tracks.
A collision shape on a link of a robot that bends is where it is in the reference pose. SI units; rotor speeds in rad/s.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path

from aerial_gym.config import checks
from aerial_gym.config.checks import NO_SOURCE, Vec3, require, require_angles, require_finite, require_positive
from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.joint import BASE, JointsCfg
from aerial_gym.config.learned_residual import LearnedResidualCfg
from aerial_gym.config.loader import load_extended
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.rotor import ROTOR_TRAITS, RotorCfg
from aerial_gym.config.sensor_mount import SensorMountCfg, as_mounts, is_file
from aerial_gym.config.shape import ROBOT_ID, PartCfg, ShapeCfg, absolute_paths
from aerial_gym.errors import ConfigError

__all__ = [
    "ROTOR_TRAITS", "BatteryCfg", "BodyCfg", "BoxCfg", "CapsuleCfg", "CollisionCfg", "CollisionShape",
    "InitialStateCfg", "MountCfg", "MountsCfg", "RobotCfg", "RotorCfg", "SensorMountCfg", "SphereCfg", "Vec3",
    "load_robot",
]  # fmt: skip


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

    source: str = NO_SOURCE  # Source of the numbers

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


@dataclass(frozen=True, kw_only=True)
class BodyCfg:
    """Mass and inertia of the whole vehicle, rotors and links included, in its reference pose."""

    mass: float  # Mass [kg], > 0

    inertia: tuple[Vec3, Vec3, Vec3]
    """Inertia about the composite centre of mass [kg m²], body axes; symmetric, positive definite, and each principal
    moment at most the sum of the others (no real body violates this)."""

    com: Vec3 = (0.0, 0.0, 0.0)  # Centre of mass from the body origin [m], body axes

    accelerometer: Vec3 = field(default=(0.0, 0.0, 0.0), repr=False)
    """Place of the accelerometer of its flight logs from the body origin [m], body axes. No simulation depends on it."""

    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        checks.require_positive(self, "mass")
        checks.require_finite(self, "com", "accelerometer")
        checks.require_inertia(self)


@dataclass(frozen=True, kw_only=True)
class BatteryCfg:
    """Voltage, internal resistance and capacity of the battery; only effects that depend on it need them."""

    nominal_voltage: float  # At which the rotors reach the commanded speeds [V], > 0
    full_voltage: float  # Without load, fully charged [V], > 0. Each reset starts here
    empty_voltage: float  # Without load, when `capacity` is drawn [V], > 0 and at most `full_voltage`
    internal_resistance: float  # Of cells, wires and plugs together [Ohm], >= 0
    capacity: float  # Charge from full to empty [A s], > 0; 1 A h is 3600 A s
    efficiency: float = 1.0  # Mechanical power of the rotors per electrical power of the battery, in (0, 1]
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        checks.require_positive(self, "nominal_voltage", "full_voltage", "empty_voltage", "capacity", "efficiency")
        holds = self.empty_voltage <= self.full_voltage
        checks.require(self, "empty_voltage", holds, f"must be at most full_voltage = {self.full_voltage!r}")
        checks.require_not_negative(self, "internal_resistance")
        checks.require(self, "efficiency", self.efficiency <= 1.0, "must be at most 1")


@dataclass(frozen=True, kw_only=True)
class MountCfg:
    """Place of one rotor."""

    position: Vec3  # Hub from the body origin [m], body axes
    axis: Vec3 = (0.0, 0.0, 1.0)  # Direction of positive thrust, body axes; made unit length
    spin: int  # +1 if the rotor turns positively about its axis, else -1. The body feels `-spin` times the torque
    rotor: str | None = None  # Name in `rotors` of its type; none where all mounts have the one type `rotor`
    link: str = BASE  # Carrier: `base`, or the joint whose link carries it (`config.joint`)

    def __post_init__(self) -> None:
        checks.require_finite(self, "position", "axis")
        checks.require(self, "axis", sum(a * a for a in self.axis) >= 1e-12, "must not be zero")
        checks.require(self, "spin", self.spin in (-1, 1), "must be 1 or -1")


@dataclass(frozen=True, kw_only=True)
class MountsCfg:
    """Places of all rotors, in the order of commands and logs."""

    layout: tuple[MountCfg, ...]  # At least one
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        checks.require(self, "layout", bool(self.layout), "needs at least one rotor")


@dataclass(frozen=True, kw_only=True)
class InitialStateCfg:
    """Uniform ranges from which a reset draws."""

    position_ratio_low: Vec3 = (0.1, 0.15, 0.15)  # Lowest position, a share of the bounds (0 lower, 1 upper face)
    position_ratio_high: Vec3 = (0.2, 0.85, 0.85)  # Highest position, likewise
    euler_low: Vec3 = (0.0, 0.0, -0.5235988)  # Lowest ZYX roll, pitch, yaw [rad]
    euler_high: Vec3 = (0.0, 0.0, 0.5235988)  # Highest roll, pitch, yaw [rad]
    lin_vel_low: Vec3 = (-0.2, -0.2, -0.2)  # Lowest velocity [m/s], world
    lin_vel_high: Vec3 = (0.2, 0.2, 0.2)  # Highest velocity [m/s], world
    ang_vel_low: Vec3 = (-0.2, -0.2, -0.2)  # Lowest angular velocity [rad/s], body
    ang_vel_high: Vec3 = (0.2, 0.2, 0.2)  # Highest angular velocity [rad/s], body

    def __post_init__(self) -> None:
        checks.require_ranges(self, "position_ratio", "euler", "lin_vel", "ang_vel")


@dataclass(frozen=True, kw_only=True)
class RobotCfg:
    """A multirotor."""

    summary: str  # One line for people who choose a robot
    body: BodyCfg  # Mass and inertia
    rotor: RotorCfg | None = None  # The rotor type of all mounts. Exactly one of this and `rotors` is given

    rotors: Mapping[str, RotorCfg] = field(default_factory=dict)
    """Rotor types by name, where mounts differ; each mount then names its own (``rotor: name``)."""

    mounts: MountsCfg  # Positions and axes of the rotors
    joints: JointsCfg | None = None  # Joints; None for a rigid vehicle. All other numbers are for the reference pose
    collision: CollisionCfg  # Collision shapes
    initial_state: InitialStateCfg = InitialStateCfg()  # Initial state, drawn at reset

    randomize: Mapping[str, RandomizeCfg] = field(default_factory=dict)
    """Quantities drawn at every reset of an environment, by name (``docs/guides/randomise.md``)."""

    battery: BatteryCfg | None = None  # The battery; only effects that depend on it need it
    control: ControlCfg = field(default_factory=ControlCfg)
    """Control settings: bandwidths, damping, limits, or explicit gains; missing ones are derived."""

    sensors: tuple[str | SensorMountCfg, ...] = ()
    """Sensors and IMUs on board: a name or a file in the sensor's own place, or a mount of its own."""

    imu: str | None = None  # Additional IMU, before those of `sensors`, which writes `imu_measurement`

    visible: bool = False
    """Whether its own sensors see it, and the shadow that it throws in their colour images. Those of other vehicles in its
    environment always do. It is never part of the collision test nor of the placement of obstacles."""

    visual: tuple[PartCfg, ...] = ()
    """Visible shapes in the body frame, each on its link; the collision shapes if none is given. A ray that starts
    inside a shape sees it from within, so sensors belong outside. Segmentation shows 0, or the id of the vehicle where
    there are several, unless a part has an id of its own.
    ``load_robot`` takes mesh paths relative to the robot's own file."""

    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Physical effects beyond rigid body and rotors: parameters by effect name (``aerial-gym list effects``)."""

    effects_source: str = ""  # Source of the numbers of effects
    learned_residual: LearnedResidualCfg | None = None  # Force and torque learned from flights, beyond all effects

    @property
    def num_rotors(self) -> int:
        """Number of rotors R."""
        return len(self.mounts.layout)

    @property
    def sensor_mounts(self) -> tuple[SensorMountCfg, ...]:
        """Every sensor and IMU on board."""
        return as_mounts((*([] if self.imu is None else [self.imu]), *self.sensors))

    @property
    def rotor_types(self) -> tuple[RotorCfg, ...]:
        """Rotor types of the mounts, R entries."""
        if self.rotor is not None:
            return (self.rotor,) * self.num_rotors
        return tuple(self.rotors[mount.rotor or ""] for mount in self.mounts.layout)

    @property
    def rotor_traits(self) -> frozenset[str]:
        """Special features of its rotors, names of ``ROTOR_TRAITS``."""
        return frozenset().union(*(rotor.traits for rotor in self.rotor_types))

    def the_rotor(self, purpose: str) -> RotorCfg:
        """Return the only rotor type; raise ``ConfigError`` with the purpose if mounts have different ones."""
        first, *rest = self.rotor_types
        if any(other != first for other in rest):
            names = ", ".join(self.rotors)
            raise ConfigError(f"{purpose} needs one rotor type, but the mounts of this robot have several: {names}")
        return first

    @property
    def appearance(self) -> tuple[PartCfg, ...]:
        """Shapes that the sensors of others see, in the frames of its links."""
        return self.visual or self.collision.parts

    @property
    def visible_parts(self) -> tuple[PartCfg, ...]:
        """Shapes that its own sensors see, in the frames of its links; none unless it is visible."""
        parts = self.appearance if self.visible else ()
        return tuple(replace(part, semantic_id=ROBOT_ID) if part.semantic_id is None else part for part in parts)

    def __repr__(self) -> str:
        joints = 0 if self.joints is None else len(self.link_names) - 1
        parts = [f"{self.body.mass:.4g} kg", f"{self.num_rotors} rotors", *([f"{joints} joints"] if joints else [])]
        for kind, names in (("sensors", [mount.key for mount in self.sensor_mounts]), ("effects", list(self.effects))):
            parts += [f"{kind} {', '.join(names)}"] if names else []
        return f"RobotCfg: {self.summary}; {'; '.join(parts)}"

    def __post_init__(self) -> None:
        for effect, params in self.effects.items():
            for name, value in params.items():
                if not isfinite(value):
                    checks.refuse(f"RobotCfg.effects.{effect}.{name} = {value!r}: must be finite")
        _ = self.sensor_mounts  # refuses equal names
        self._check_rotors()
        self._check_joints()
        if self.visible and not self.visual and not self.collision.shapes:
            checks.refuse("RobotCfg.visible: there is nothing to see. List shapes in visual, or collision shapes")

    def _check_rotors(self) -> None:
        if (self.rotor is None) == (not self.rotors):
            checks.refuse("RobotCfg: give exactly one of rotor (type of all mounts) and rotors (types by name)")
        for number, mount in enumerate(self.mounts.layout, 1):
            if self.rotor is not None and mount.rotor is not None:
                checks.refuse(
                    f"RobotCfg.mounts.layout: mount {number} names the rotor type {mount.rotor!r}, but there is one type for "
                    "all, rotor. List types by name in rotors"
                )
            if self.rotors and mount.rotor not in self.rotors:
                known = ", ".join(self.rotors)
                checks.refuse(
                    f"RobotCfg.mounts.layout: mount {number}: rotor = {mount.rotor!r}: must be one of {known}"
                )
        if unused := set(self.rotors) - {mount.rotor for mount in self.mounts.layout}:
            checks.refuse(f"RobotCfg.rotors.{min(unused)}: no mount has this type")

    @property
    def collides_with_links(self) -> bool:
        """Whether there are collision shapes on links other than the base."""
        return any(shape.link != BASE for shape in self.collision.shapes)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links; the base alone for a rigid robot."""
        return (BASE,) if self.joints is None else self.joints.link_names

    def _check_joints(self) -> None:
        if self.collision.between_links and self.joints is None:
            checks.refuse("RobotCfg.collision.between_links: the robot has no joints, and one link alone")
        carried = [(f"mounts.layout: mount {number}", mount.link) for number, mount in enumerate(self.mounts.layout, 1)]
        carried += [(f"visual: part {number}", part.link) for number, part in enumerate(self.visual, 1)]
        carried += [(f"collision: shape {number}", shape.link) for number, shape in enumerate(self.collision.shapes, 1)]
        carried += [(f"sensors: {mount.key}", mount.link) for mount in self.sensor_mounts]
        for label, link in carried:
            if link not in self.link_names:
                known = ", ".join(self.link_names)
                checks.refuse(f"RobotCfg.{label} sits on link {link!r}: must be a link of the robot ({known})")


def load_robot(path: str | Path) -> RobotCfg:
    """Return the robot in a YAML file, which may extend another; paths are relative to the file that names them."""
    return load_extended(RobotCfg, path, family="robots", located=_absolute_files)


def _absolute_files(cfg: RobotCfg, folder: Path) -> RobotCfg:
    """Return a robot with absolute file paths; relative ones count from ``folder``."""

    def absolute_path(name: str) -> str:
        return str(folder / name) if is_file(name) else name

    parts = (replace(part, shape=absolute_paths(part.shape, folder)) for part in cfg.visual)
    sensors = (
        absolute_path(each) if isinstance(each, str) else replace(each, sensor=absolute_path(each.sensor))
        for each in cfg.sensors
    )
    return replace(cfg, visual=tuple(parts), sensors=tuple(sensors), imu=cfg.imu and absolute_path(cfg.imu))
