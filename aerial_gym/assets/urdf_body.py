"""Mass and inertia of rigidly joined links, and of a URDF file as one rigid body, joints fixed at zero.

Frames: axes and origin of the root link; SI units. Letters: L links.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerial_gym.assets.urdf import link_poses, read_urdf
from aerial_gym.errors import ConfigError


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
