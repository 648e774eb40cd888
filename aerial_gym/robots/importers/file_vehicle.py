"""Content of an imported vehicle file: one body, rotors with their known data, joints, shapes, lift and unused elements.

Weightless masses become the effect ``buoyancy``, or ``link_buoyancy`` of vehicles with joints. A body of mass m with gravity
compensation c feels ``c m g`` upwards at its centre of mass. Parallel forces act like their sum at their weighted centre.
Joints carry welded groups of links, with mass and shapes, and are where the file has them at first.
Frames: axes and origin of the root link, which become the body's: x forward, y left, z up. SI units.
"""

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from aerial_gym.assets import load_mesh
from aerial_gym.assets.urdf import RigidBody, weld
from aerial_gym.config.joint import EndsCfg, JointCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionCfg, CollisionShape, PartCfg, RotorCfg, SphereCfg, Vec3
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class FileRotor:
    """A place where a rotor pushes."""

    name: str  # In the file
    position: np.ndarray  # Point of application of the thrust [m], (3,)
    axis: np.ndarray  # Direction of positive thrust, unit, (3,)
    spin: int | None = None  # Sense of turning about the axis; None where the file says nothing
    rotor: RotorCfg | None = None  # Its type; None where the file says nothing
    link: str = BASE  # Joint whose link carries it, or the base


@dataclass(frozen=True, kw_only=True)
class WeightlessMass:
    """Mass without weight: gravity compensation of MJCF, links without gravity of SDF and URDF."""

    mass: float  # [kg]; below 0 where the file adds weight
    position: np.ndarray  # Centre of mass [m], (3,)
    link: str = BASE  # Joint whose link it is on, or the base


@dataclass(frozen=True, kw_only=True)
class FileVehicle:
    """A vehicle as a file describes it."""

    body: RigidBody
    rotors: Sequence[FileRotor]
    shapes: Sequence[CollisionShape]
    joints: tuple[JointCfg, ...] = ()  # Joints that move, if asked for
    weightless: Sequence[WeightlessMass] = ()
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    effects_source: str = ""
    notes: Sequence[str] = ()  # Unused elements of the file, a line each
    assumed: Sequence[str] = ()  # Changed or missing data, a line each
    losses: Sequence[str] = ()  # Parts left out without which it flies otherwise: wings, joints that tilt rotors


def read_xml(path: Path) -> ElementTree.Element:
    """Return the root of an XML file; raise ``ConfigError`` that names the file if it cannot be read."""
    try:
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError, ValueError, LookupError) as error:  # the last two: an unknown encoding
        raise ConfigError(f"{path}: not valid XML ({error})") from None


def round_vec3(vector: Sequence[float] | np.ndarray) -> Vec3:
    """Return three floats, with 0 for rounding errors relative to the largest."""
    values = np.asarray(vector, dtype=float)
    x, y, z = np.where(np.abs(values) < 1e-12 * np.abs(values).max(initial=0.0), 0.0, values).tolist()
    return x, y, z


def euler_of_matrix(turn: np.ndarray) -> Vec3:
    """Return ZYX angles [rad] of a rotation, (3, 3)."""
    from trimesh.transformations import euler_from_matrix

    return round_vec3(euler_from_matrix(turn, axes="sxyz"))


def make_pose(xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return the homogeneous matrix (4, 4) of a position [m] and ZYX angles [rad]."""
    from trimesh.transformations import euler_matrix

    pose = euler_matrix(*rpy, axes="sxyz")
    pose[:3, 3] = xyz
    return pose


def parse_numbers(text: str | None, count: int, where: str) -> list[float]:
    """Return the numbers in a text, zeros where there is none; raise ``ConfigError`` unless ``count`` are finite."""
    if text is None or not text.split():
        return [0.0] * count
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        raise ConfigError(f"{where} = {text!r}: must be numbers") from None
    if not np.isfinite(values).all():
        raise ConfigError(f"{where} = {text!r}: must be finite")
    if len(values) != count:
        raise ConfigError(f"{where} = {text!r}: must be {count} numbers")
    return values


def parse_number(text: str | None, default: float, where: str) -> float:
    """Return the number in a text, or the default where there is none."""
    return default if text is None or not text.strip() else parse_numbers(text, 1, where)[0]


ON_AXIS = 1e-3  # Distance [m] and angle [rad] of a thrust line and a joint's axis below which the rotor spins there


def moves_thrust_line(rotor: FileRotor, kind: str, axis: np.ndarray, position: np.ndarray) -> bool:
    """Return whether a joint moves the thrust line of a rotor behind it; it does not where its axis is that line."""
    size = float(np.linalg.norm(axis))
    across = np.linalg.norm(np.cross(axis, rotor.axis)) / size if size > 0.0 else 1.0
    lever = rotor.position - position
    beside = np.linalg.norm(lever - (lever @ rotor.axis) * rotor.axis)
    return kind not in ("revolute", "continuous", "hinge") or bool(across > ON_AXIS or beside > ON_AXIS)


Tags = Mapping[str, Any]  # Tags that are used, each with those used within it


def unread_elements(
    root: Element, used: Tags, *, left_out: Container[Element] = (), named: Container[Element] = ()
) -> Iterator[str]:
    """Yield the unused elements: ``sensor: front (camera), imu (imu)``, or ``limit of axis: rotor_0_joint``.

    Args:
        left_out: Elements that are not used although their tags are.
    """
    yield from group_lines_by_kind(_unread_pairs(root, used, root.get("name", ""), left_out, named))


def group_lines_by_kind(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield one line for each kind, with the names of that kind: ``kind: name, name``."""
    names_by_kind: dict[str, dict[str, None]] = {}
    for kind, name in pairs:
        names_by_kind.setdefault(kind, {})[name] = None
    for kind, names in names_by_kind.items():
        yield f"{kind}: {', '.join(names)}"


def _unread_pairs(
    element: Element, used: Tags, owner: str, left_out: Container[Element], named: Container[Element]
) -> Iterator[tuple[str, str]]:
    for child in element:
        if child in named:
            continue
        inner = used.get(child.tag)
        if inner is None or child in left_out:
            yield _element_name(child, element, owner)
        else:
            yield from _unread_pairs(
                child, inner, child.get("name") or child.get("reference") or owner, left_out, named
            )


def _element_name(element: Element, parent: Element, owner: str) -> tuple[str, str]:
    """Return the kind of an element and its name, or its owner's name."""
    name = element.get("name") or element.get("reference") or element.findtext("uri") or element.get("filename")
    more = element.get("type") or element.get("filename")
    if name is None:
        return f"{element.tag} of {parent.tag}", owner or parent.tag
    return element.tag, name if more in (None, name) else f"{name} ({more})"


def part_collision_shape(part: PartCfg) -> CollisionShape:
    """Return spheres, capsules and boxes unchanged, and the bounding box of a cylinder or mesh."""
    shape = part.shape
    if shape.kind == "sphere":
        return SphereCfg(center=part.position, radius=shape.radius or 0.0)
    if shape.kind == "capsule":
        return CapsuleCfg(
            center=part.position, euler=part.euler, radius=shape.radius or 0.0, height=shape.height or 0.0
        )
    if shape.kind == "box" and shape.size is not None:
        return BoxCfg(center=part.position, size=shape.size, euler=part.euler)
    if shape.kind == "cylinder":
        across = 2.0 * (shape.radius or 0.0)
        return BoxCfg(center=part.position, size=(across, across, shape.height or 0.0), euler=part.euler)
    return _box_around_mesh(part)


def _box_around_mesh(part: PartCfg) -> BoxCfg:
    from trimesh.transformations import euler_matrix

    low, high = load_mesh(part.shape.path or "", scale=part.shape.scale, up=part.shape.up).bounds
    center = euler_matrix(*part.euler, axes="sxyz")[:3, :3] @ (0.5 * (low + high)) + part.position
    return BoxCfg(center=round_vec3(center), size=round_vec3(high - low), euler=part.euler)


def make_collision(shapes: Sequence[CollisionShape], name: str) -> CollisionCfg:
    """Return the collision configuration of shapes; ``name`` is the file, for errors."""
    return CollisionCfg(
        spheres=tuple(shape for shape in shapes if isinstance(shape, SphereCfg)),
        boxes=tuple(shape for shape in shapes if isinstance(shape, BoxCfg)),
        capsules=tuple(shape for shape in shapes if isinstance(shape, CapsuleCfg)),
        source=f"{name}; boxes around cylinders and around the bounds of meshes",
    )


@dataclass(frozen=True)
class BuoyantForces:
    """Upward forces on a vehicle."""

    force: float = 0.0  # All of them [N]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    source: str = ""


def buoyant_forces(vehicle: FileVehicle, gravity: float) -> BuoyantForces:
    """Return the upward forces that cancel the weight of weightless masses; raise ``ConfigError`` for added weight."""
    params: dict[str, float] = {}
    total = 0.0
    for link in dict.fromkeys(part.link for part in vehicle.weightless):
        parts = [part for part in vehicle.weightless if part.link == link and part.mass]
        mass = sum(part.mass for part in parts)
        if not parts:
            continue
        if not mass > 0.0:
            raise ConfigError(f"link {link}: gravity compensation adds {-mass:.3g} kg of weight: must be >= 0 in all")
        place = sum((part.mass * part.position for part in parts), np.zeros(3)) / mass
        own = place - _link_com(vehicle, link) if vehicle.joints else place
        prefix = f"{link}." if vehicle.joints else ""
        force = mass * gravity
        params |= {f"{prefix}{name}": float(x) for name, x in zip(("force", *"xyz"), (force, *own), strict=True)}
        total += force
    if not params:
        return BuoyantForces()
    kind = "link_buoyancy" if vehicle.joints else "buoyancy"
    return BuoyantForces(
        total, {kind: params}, f"{total / gravity:.6g} kg without weight in the file, g = {gravity:g} m/s²"
    )


def _link_com(vehicle: FileVehicle, link: str) -> np.ndarray:
    """Return the centre of mass of a link of a vehicle with joints [m], (3,)."""
    moving = [(joint.name, joint.link) for joint in vehicle.joints if joint.link is not None]
    if link != BASE:
        return np.array(next(own.com for name, own in moving if name == link))
    rest = vehicle.body.mass - sum(own.mass for _, own in moving)
    moment = vehicle.body.mass * vehicle.body.com - sum(
        (own.mass * np.array(own.com) for _, own in moving), np.zeros(3)
    )
    return moment / rest


END_HZ = 10.0  # Natural frequency of the critically damped springs that replace hard end stops [Hz]
LEAST_INERTIA = 1e-6  # Smallest inertia behind a joint, for these springs [kg m²] or [kg]

ENDS = f"chosen: ends of joints as critically damped springs of {END_HZ:g} Hz on what the joint carries in the reference pose"


@dataclass(frozen=True, kw_only=True)
class LinkMass:
    """A link with mass."""

    mass: float
    pose: np.ndarray  # Frame at its centre of mass with the axes of its inertia, (4, 4)
    inertia: np.ndarray  # About that centre [kg m²], (3, 3)


@dataclass(frozen=True, kw_only=True)
class FileJoint:
    """A joint that moves."""

    name: str
    parent: str = BASE  # Joint of its parent link, or the base
    kind: str  # `revolute` or `prismatic`
    axis: np.ndarray
    position: np.ndarray
    reference: float = 0.0
    limits: tuple[float, float] | None = None
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    weights: Sequence[LinkMass] = field(default_factory=tuple)  # Of the links that it carries and no other joint moves


def joint_configs(joints: Sequence[FileJoint]) -> tuple[JointCfg, ...]:
    """Return joints as a robot file has them, parents first."""
    return tuple(_joint_cfg(joint, joints) for joint in joints)


def _total_mass(weights: Sequence[LinkMass]) -> float:
    return sum(weight.mass for weight in weights)


def _joint_cfg(joint: FileJoint, joints: Sequence[FileJoint]) -> JointCfg:
    axis = joint.axis / np.linalg.norm(joint.axis)
    spring = None
    if joint.stiffness > 0.0 or joint.damping > 0.0 or joint.friction > 0.0:
        spring = SpringCfg(stiffness=joint.stiffness, damping=joint.damping, friction=joint.friction, rest=joint.rest)
    ends = None
    if joint.limits is not None:
        inertia = max(_inertia_behind_joint(joint, joints, axis), LEAST_INERTIA)
        rate = 2.0 * pi * END_HZ
        ends = EndsCfg(
            low=joint.limits[0],
            high=joint.limits[1],
            stiffness=float(f"{inertia * rate**2:.4g}"),
            damping=float(f"{2.0 * inertia * rate:.4g}"),
        )
    return JointCfg(
        name=joint.name, parent=joint.parent, kind=joint.kind, axis=round_vec3(axis),
        position=round_vec3(joint.position), reference=joint.reference, link=_link_cfg(joint.weights), spring=spring,
        ends=ends,
    )  # fmt: skip


def _link_cfg(weights: Sequence[LinkMass]) -> LinkCfg | None:
    if _total_mass(weights) <= 0.0:
        return None
    body = weld([w.mass for w in weights], [w.pose for w in weights], [w.inertia for w in weights])
    rows = [round_vec3(row) for row in body.inertia]
    return LinkCfg(mass=body.mass, com=round_vec3(body.com), inertia=(rows[0], rows[1], rows[2]))


def _inertia_behind_joint(joint: FileJoint, joints: Sequence[FileJoint], axis: np.ndarray) -> float:
    """Return inertia about the axis [kg m²], or mass [kg], of all that a joint moves."""
    names, weights = {joint.name}, list(joint.weights)
    for other in joints:
        if other.parent in names:
            names.add(other.name)
            weights += other.weights
    if joint.kind == "prismatic":
        return _total_mass(weights)
    total = 0.0
    for weight in weights:
        turn, lever = weight.pose[:3, :3], weight.pose[:3, 3] - joint.position
        across = lever - (lever @ axis) * axis
        total += float(axis @ turn @ weight.inertia @ turn.T @ axis + weight.mass * (across @ across))
    return total


def joint_moving_each_link(
    links: Sequence[str], joint_above: Callable[[str], tuple[str, str] | None], moving: Mapping[str, str]
) -> dict[str, str]:
    """Return the name of the joint that moves each link, or the base.

    Args:
        moving: Names in the robot file of the joints that move, by their names in the other.
    """
    carriers: dict[str, str] = {}
    for link in links:
        at: str | None = link
        while at is not None:
            above = joint_above(at)
            if above is None:
                carriers[link], at = BASE, None
            elif above[0] in moving:
                carriers[link], at = moving[above[0]], None
            else:
                at = above[1]
    return carriers
