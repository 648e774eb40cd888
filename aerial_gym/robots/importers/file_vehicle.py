"""Content of an imported vehicle file: one body, rotors with their known data, shapes and notes.

Frames: axes and origin of the root link, which become the body's: x forward, y left, z up. SI units.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from aerial_gym.assets.urdf_body import RigidBody
from aerial_gym.config.joint import JointCfg
from aerial_gym.config.robot import CollisionShape, RotorCfg, Vec3
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
class Weightless:
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
    weightless: Sequence[Weightless] = ()

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


def vec3(vector: Sequence[float] | np.ndarray) -> Vec3:
    """Return three floats, with 0 for rounding errors relative to the largest."""
    values = np.asarray(vector, dtype=float)
    x, y, z = np.where(np.abs(values) < 1e-12 * np.abs(values).max(initial=0.0), 0.0, values).tolist()
    return x, y, z


def roll_pitch_yaw(turn: np.ndarray) -> Vec3:
    """Return ZYX angles [rad] of a rotation, (3, 3)."""
    from trimesh.transformations import euler_from_matrix

    return vec3(euler_from_matrix(turn, axes="sxyz"))


def make_pose(xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return the homogeneous matrix (4, 4) of a position [m] and ZYX angles [rad]."""
    from trimesh.transformations import euler_matrix

    pose = euler_matrix(*rpy, axes="sxyz")
    pose[:3, 3] = xyz
    return pose


def numbers(text: str | None, count: int, where: str) -> list[float]:
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


def number(text: str | None, default: float, where: str) -> float:
    """Return the number in a text, or the default where there is none."""
    return default if text is None or not text.strip() else numbers(text, 1, where)[0]


ON_AXIS = 1e-3
"""Distance of a thrust line from the axis of a joint [m], and angle between them [rad], below which the rotor spins there."""


def tilts(rotor: FileRotor, kind: str, axis: np.ndarray, position: np.ndarray) -> bool:
    """Return whether a joint moves the thrust line of a rotor behind it; it does not where its axis is that line."""
    size = float(np.linalg.norm(axis))
    across = np.linalg.norm(np.cross(axis, rotor.axis)) / size if size > 0.0 else 1.0
    lever = rotor.position - position
    beside = np.linalg.norm(lever - (lever @ rotor.axis) * rotor.axis)
    return kind not in ("revolute", "continuous", "hinge") or bool(across > ON_AXIS or beside > ON_AXIS)
