"""URDF files: links as one body, rotors from motor plugins for Gazebo or from links that are named like rotors.

The type of the latter is that of another robot, or what an element ``properties`` says of them.
"""

import re
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from aerial_gym.assets.urdf import link_poses, load_urdf, read_urdf
from aerial_gym.assets.urdf_body import urdf_body
from aerial_gym.config.robot import CollisionShape, RotorCfg
from aerial_gym.config.shape import BASE, FIRST_INSTANCE_ID, PartCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.found import Found, FoundRotor, numbers
from aerial_gym.robots.importers.joints import FoundJoint, Weight, carriers_of, layout_of
from aerial_gym.robots.importers.motors import motors_in, notes_on, sideways_effects
from aerial_gym.robots.importers.shapes import shape_of

if TYPE_CHECKING:
    from yourdfpy import URDF
    from yourdfpy.urdf import Joint


def read(path: Path, rotor_links: str, lag: float | None, *, take_properties: bool, joints: bool = False) -> Found:
    """Return the vehicle of a URDF file.

    Args:
        path: The file, expanded if it was a xacro.
        rotor_links: Regular expression of names of links at whose centres of mass (at whose origins, where the file gives
            none) rotors push along z, for files without motors.
        lag: Of the rotors that ``properties`` describe [s]; None refuses them.
        take_properties: Whether to read what ``properties`` say of rotors.
        joints: Whether revolute, continuous and prismatic joints move, but those of rotors and those that mimic another.
    """
    body, robot = urdf_body(path), read_urdf(path)
    poses = link_poses(robot)
    root = ElementTree.parse(path).getroot()
    motors, where = motors_in(root, f"URDF {path.name}"), f"URDF {path.name}"
    spun = {motor.joint for motor in motors}
    names = [] if motors else [name for name in poses if re.fullmatch(rotor_links, name)]
    spun |= {joint.name for joint in robot.joint_map.values() if joint.child in names and joint.type == "continuous"}
    moving, on, notes = _moving(robot, poses, spun, where) if joints else ([], dict.fromkeys(poses, BASE), [])
    layout, shapes = layout_of(moving), _shapes(path, list(robot.link_map), on)
    if not motors:
        kind = _described(root, body.mass, len(names), lag, where) if names and take_properties else None
        rotors = [
            FoundRotor(name=n, position=_hub(robot, n, poses[n]), axis=poses[n][:3, 2], rotor=kind, link=on[n])
            for n in names
        ]
        return Found(body=body, rotors=rotors, shapes=shapes, joints=layout, notes=tuple(notes))
    axes = {}
    for joint in root.iter("joint"):
        axis = joint.find("axis")
        axes[joint.get("name")] = numbers("1 0 0" if axis is None else axis.get("xyz"), 3, f"{where}: axis of a joint")
    rotors = []
    for motor in motors:
        if motor.link not in poses or motor.joint not in axes:
            raise ConfigError(
                f"{where}: there is no link {motor.link!r} or no joint {motor.joint!r} for one of its motors"
            )
        pose = poses[motor.link]
        axis = pose[:3, :3] @ axes[motor.joint]
        rotors.append(
            FoundRotor(
                name=motor.link,
                position=pose[:3, 3],
                axis=axis,
                spin=motor.spin,
                rotor=motor.rotor,
                link=on[motor.link],
            )
        )
    return Found(
        body=body,
        rotors=rotors,
        shapes=shapes,
        joints=layout,
        effects=sideways_effects(motors),
        notes=(*notes_on(motors), *notes),
    )


def _hub(robot: "URDF", link: str, pose: np.ndarray) -> np.ndarray:
    """Return the centre of mass of a link [m], (3,): simulators push there, and some files place rotors by it alone."""
    inertial = robot.link_map[link].inertial
    return (pose if inertial is None or inertial.origin is None else pose @ inertial.origin)[:3, 3]


def _described(root: ElementTree.Element, mass: float, count: int, lag: float | None, where: str) -> RotorCfg | None:
    """Return the rotor type in the element ``properties`` of gym-pybullet-drones, or None if there is none.

    ``kf`` [N/rpm²], ``km`` [N m/rpm²], and ``thrust2weight``, the thrust of all rotors per weight.
    """
    found = root.find("properties")
    if found is None or any(found.get(name) is None for name in ("kf", "km", "thrust2weight")):
        return None
    if lag is None:
        raise ConfigError(
            f"{where}: its properties tell thrust and torque of rotors, and no lag. Give one (--lag-s, lag of RotorHints), "
            "measured or that of a similar motor: 0.02 to 0.1 s"
        )
    kf, km, ratio = (numbers(found.get(n), 1, f"{where}: properties")[0] for n in ("kf", "km", "thrust2weight"))
    return RotorCfg(
        thrust_map=(0.0, 0.0, kf * (30.0 / pi) ** 2),
        torque_ratio=km / kf,
        time_constant_up=lag,
        time_constant_down=lag,
        thrust_range=(0.0, ratio * mass * STANDARD_GRAVITY / count),
        source=f"{where}, properties: kf, km, thrust2weight; lag of {lag:g} s: given when it was imported",
    )


def _moving(
    robot: "URDF", poses: dict[str, np.ndarray], spun: set[str], where: str
) -> tuple[list[FoundJoint], dict[str, str], list[str]]:
    """Return the joints that move, parents first, the one that moves each link, and notes."""
    above = {joint.child: joint for joint in robot.joint_map.values()}
    moving, notes = {}, []
    for joint in robot.joint_map.values():
        if joint.type in ("floating", "planar"):
            raise ConfigError(f"{where}: joint {joint.name!r} is {joint.type}: joints have one degree of freedom here")
        if joint.type == "fixed" or joint.name in spun:
            continue
        if joint.mimic is not None:
            notes.append(f"joint {joint.name}: mimics another one, and is welded")
            continue
        moving[joint.name] = joint.name
    on = carriers_of(
        list(poses), lambda link: (above[link].name, above[link].parent) if link in above else None, moving
    )
    weights: dict[str, list[Weight]] = {}
    for name, link in robot.link_map.items():
        own = link.inertial
        if own is not None and own.mass:
            pose = poses[name] if own.origin is None else poses[name] @ own.origin
            inertia = np.zeros((3, 3)) if own.inertia is None else np.asarray(own.inertia, dtype=float)
            weights.setdefault(on[name], []).append(Weight(mass=float(own.mass), pose=pose, inertia=inertia))
    found, waiting = [], [joint for joint in robot.joint_map.values() if joint.name in moving]
    placed = {BASE}
    while waiting:
        joint = next(joint for joint in waiting if on[joint.parent] in placed)
        waiting.remove(joint)
        placed.add(joint.name)
        found.append(_joint(joint, poses[joint.child], on[joint.parent], weights.get(joint.name, [])))
    return found, on, notes


def _joint(joint: "Joint", pose: np.ndarray, parent: str, weights: list[Weight]) -> FoundJoint:
    limit, dynamics = joint.limit, joint.dynamics
    limits = None
    if joint.type != "continuous" and limit is not None and limit.lower is not None and limit.upper is not None:
        limits = float(limit.lower), float(limit.upper)
    return FoundJoint(
        name=joint.name,
        parent=parent,
        kind="prismatic" if joint.type == "prismatic" else "revolute",
        axis=pose[:3, :3] @ np.asarray(joint.axis, dtype=float),
        position=pose[:3, 3],
        limits=limits,
        damping=0.0 if dynamics is None else float(dynamics.damping or 0.0),
        friction=0.0 if dynamics is None else float(dynamics.friction or 0.0),
        weights=weights,
    )


def _shapes(path: Path, names: list[str], on: dict[str, str]) -> list[CollisionShape]:
    """Return the collision shapes of all links, each on its link; none of a file without geometry."""
    if all(link == BASE for link in on.values()):
        return _all_shapes(path, {})
    found = []
    for start in range(0, len(names), FIRST_INSTANCE_ID):  # semantic ids tell the links apart
        some = names[start : start + FIRST_INSTANCE_ID]
        ids = {name: k for k, name in enumerate(some)}
        for part in _parts(path, ids):
            if part.semantic_id is not None:
                found.append(replace(shape_of(part), link=on[some[part.semantic_id]]))
    return found


def _all_shapes(path: Path, ids: dict[str, int]) -> list[CollisionShape]:
    return [shape_of(part) for part in _parts(path, ids)]


def _parts(path: Path, ids: dict[str, int]) -> tuple[PartCfg, ...]:
    try:
        return load_urdf(path, link_ids=ids).parts or ()
    except ConfigError as error:
        if "holds no geometry" in str(error):
            return ()
        raise
