"""Mass and inertia of a URDF file as one rigid body, joints fixed at zero.

Frames: axes and origin of the root link; SI units.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerial_gym.assets.urdf import link_poses, read_urdf
from aerial_gym.errors import ConfigError


@dataclass(frozen=True)
class RigidBody:
    """What all links weigh together."""

    mass: float
    """[kg]."""

    com: np.ndarray
    """Centre of mass from the origin of the root link [m], (3,)."""

    inertia: np.ndarray
    """About the centre of mass, axes of the root link [kg m²], (3, 3)."""


def urdf_body(path: str | Path) -> RigidBody:
    """Return the links of a URDF as one body, by the parallel axis theorem.

    Raises:
        ConfigError: If the file cannot be read, or no link has a mass.

    Source:
        Derived: ``J = sum R_i J_i R_i^T + m_i (|r_i|² 1 - r_i r_i^T)`` with r_i from the common centre of mass.
    """
    robot = read_urdf(path)
    at = link_poses(robot)
    links = [(link.inertial, at[name]) for name, link in robot.link_map.items() if link.inertial is not None]
    poses = [pose if inertial.origin is None else pose @ inertial.origin for inertial, pose in links]
    masses = np.array([inertial.mass or 0.0 for inertial, _ in links])
    if not masses.sum() > 0.0:
        raise ConfigError(f"URDF {path}: no link has a mass")
    places = np.array([pose[:3, 3] for pose in poses])
    com = masses @ places / masses.sum()
    inertia = np.zeros((3, 3))
    for (inertial, _), pose, mass, place in zip(links, poses, masses, places, strict=True):
        turn, arm = pose[:3, :3], place - com
        own = np.zeros((3, 3)) if inertial.inertia is None else np.asarray(inertial.inertia, dtype=float)
        inertia += turn @ own @ turn.T + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return RigidBody(float(masses.sum()), com, 0.5 * (inertia + inertia.T))
