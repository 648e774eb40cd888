"""Joints of imported files: welded groups of links, and mass and shapes behind each joint.

Frames: axes and origin of the root link, all joints where the file has them at first. SI units.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi

import numpy as np

from aerial_gym.assets.urdf import weld
from aerial_gym.config.joint import EndsCfg, JointCfg, LinkCfg, SpringCfg
from aerial_gym.config.shape import BASE
from aerial_gym.robots.importers.file_vehicle import round_vec3

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
        name=joint.name,
        parent=joint.parent,
        kind=joint.kind,
        axis=round_vec3(axis),
        position=round_vec3(joint.position),
        reference=joint.reference,
        link=_link_cfg(joint.weights),
        spring=spring,
        ends=ends,
    )


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
