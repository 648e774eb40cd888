"""What the readers of files find: one body, places of rotors with whatever is known of them, shapes, and notes.

Frames: axes and origin of the root link, which become the body's: x forward, y left, z up. SI units.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from aerial_gym.assets.urdf_body import RigidBody
from aerial_gym.config.joint import JointCfg
from aerial_gym.config.robot import CollisionShape, RotorCfg, Vec3
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class FoundRotor:
    """A place where a rotor pushes."""

    name: str
    """In the file."""

    position: np.ndarray
    """Where its thrust acts [m], (3,)."""

    axis: np.ndarray
    """Direction of positive thrust, unit, (3,)."""

    spin: int | None = None
    """Sense of turning about the axis; None where the file says nothing."""

    rotor: RotorCfg | None = None
    """Its type; None where the file says nothing."""

    link: str = BASE
    """Joint whose link carries it, or the base."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """A vehicle as a file describes it."""

    body: RigidBody
    rotors: Sequence[FoundRotor]
    shapes: Sequence[CollisionShape]
    joints: tuple[JointCfg, ...] = ()
    """Joints that move, if asked for."""

    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    notes: Sequence[str] = ()
    """What the file holds and is not taken over, in sentences."""


def vec3(vector: Sequence[float] | np.ndarray) -> Vec3:
    """Return three floats; what is round-off beside the largest of them is 0."""
    values = np.asarray(vector, dtype=float)
    x, y, z = np.where(np.abs(values) < 1e-12 * np.abs(values).max(initial=0.0), 0.0, values).tolist()
    return x, y, z


def roll_pitch_yaw(turn: np.ndarray) -> Vec3:
    """Return ZYX angles [rad] of a rotation, (3, 3)."""
    from trimesh.transformations import euler_from_matrix

    return vec3(euler_from_matrix(turn, axes="sxyz"))


def pose_of(xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return a frame (4, 4) from its place [m] and ZYX angles [rad]."""
    from trimesh.transformations import euler_matrix

    pose = euler_matrix(*rpy, axes="sxyz")
    pose[:3, 3] = xyz
    return pose


def numbers(text: str | None, count: int, where: str) -> list[float]:
    """Return the numbers in a text; zeros where there is none.

    Raises:
        ConfigError: If there are not as many, or one is none.
    """
    if text is None or not text.split():
        return [0.0] * count
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        raise ConfigError(f"{where} = {text!r}: must be numbers") from None
    if len(values) != count:
        raise ConfigError(f"{where} = {text!r}: must be {count} numbers")
    return values
