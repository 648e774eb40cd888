"""URDF files: links as one body, rotors from motor plugins for Gazebo or from links that are named like rotors.

The type of the latter is that of another robot, or what an element ``properties`` says of them. Every joint is welded unless
asked otherwise; a welded one that moves the thrust line of a rotor is a loss, as are plugins of wings.
Files of gym-pybullet-drones have ``properties``: ``kf`` [N/rpm²] and ``km`` [N m/rpm²] give thrust and torque,
``thrust2weight`` the largest thrust of all rotors per weight. With speeds w in rad/s and velocities v in body axes that
simulator adds:

- a force ``-drag_coeff_xy w v`` across each rotor and ``-drag_coeff_z w v`` along it: ``h_force_flapping``, ``axial_inflow``;
- a gain of thrust of ``gnd_eff_coeff (R / 4h)²`` near the ground, R being ``prop_radius``: ``ground_effect`` in first order;
- below another vehicle a force ``-dw_coeff_1 (R / 4z)² exp(-d² / 2 (dw_coeff_2 z + dw_coeff_3)²)``: ``downwash`` at one z.

Source: Panerati et al. (2021), Learning to fly; gym-pybullet-drones, BaseAviary.py (``_physics``, ``_groundEffect``,
``_drag``, ``_downwash_params``).
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from aerial_gym.assets.urdf import link_poses, load_urdf, read_urdf, urdf_body
from aerial_gym.config.robot import CollisionShape
from aerial_gym.config.shape import BASE, FIRST_INSTANCE_ID, PartCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers import file_vehicle
from aerial_gym.robots.importers.motors import (
    MOTOR_TAGS,
    Motor,
    force_source_to_omit,
    is_motor,
    motor_assumptions,
    motor_notes,
    read_motors,
    sideways_drag_effect,
)

if TYPE_CHECKING:
    from yourdfpy import URDF
    from yourdfpy.urdf import Joint

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import pi
from xml.etree.ElementTree import Element

from aerial_gym.config.robot import RotorCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.physics.effects import EFFECTS
from aerial_gym.robots.importers.file_vehicle import parse_numbers

BELOW = 1.0  # Distance to the vehicle above at which its downwash is taken [m]: the effect has no law of distance

_PER_RPM = (30.0 / pi) ** 2


@dataclass(frozen=True)
class Properties:
    """Content of the element."""

    rotor: RotorCfg | None = None
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    source: str = ""
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


def read_properties(root: Element, mass: float, count: int, lag: float | None, where: str) -> Properties:
    """Return rotor type and effects of a URDF with ``count`` rotors and this lag [s]; nothing without thrust and torque."""
    element = root.find("properties")
    if element is None:
        return Properties()
    given = dict(element.attrib)
    if not count or any(given.get(name) is None for name in ("kf", "km", "thrust2weight")):
        return Properties(notes=_unread_properties(given, set()))
    known = {"kf", "km", "thrust2weight", *(name for _, needed, _ in _EFFECTS for name in needed)} & set(given)
    value = {name: parse_numbers(given[name], 1, f"{where}: properties: {name}")[0] for name in known}
    if lag is None:
        raise ConfigError(
            f"{where}: its properties tell thrust and torque of rotors, and no lag. Give one (--lag-s, lag of RotorHints), "
            "measured or that of a similar motor: 0.02 to 0.1 s"
        )
    rotor = RotorCfg(
        thrust_map=(0.0, 0.0, value["kf"] * _PER_RPM), torque_ratio=value["km"] / value["kf"], time_constant_up=lag,
        time_constant_down=lag, thrust_range=(0.0, value["thrust2weight"] * mass * STANDARD_GRAVITY / count),
        radius=value.get("prop_radius"),
        source=f"{where}, properties: kf, km, thrust2weight; lag of {lag:g} s: given when it was imported",
    )  # fmt: skip
    used, effects, refused = {"kf", "km", "thrust2weight", "prop_radius"}, {}, {}
    for name, needed, rule in _EFFECTS:
        if not all(one in value for one in needed):
            continue
        params = rule(value)
        used.update(needed)
        if problem := _range_problem(name, params):
            refused.setdefault(", ".join(needed), problem)
        elif any(params.values()):
            effects[name] = params
    far = f"downwash at every distance as at {BELOW:g} m below the other vehicle (dw_coeff_1 to dw_coeff_3)"
    source = f"{where}, properties, by the laws of gym-pybullet-drones" if effects else ""
    notes = [f"properties: {names}: {problem}" for names, problem in refused.items()]
    return Properties(
        rotor, effects, source, (*notes, *_unread_properties(given, used)), (far,) if "downwash" in effects else ()
    )


def _unread_properties(given: Mapping[str, str], used: set[str]) -> tuple[str, ...]:
    rest = [name for name in given if name not in used]
    return (f"properties: {', '.join(rest)}",) if rest else ()


def _range_problem(name: str, params: Mapping[str, float]) -> str | None:
    """Return the first parameter of an effect outside its bounds, as text; None if all are within."""
    for parameter in EFFECTS.get(name).parameters:
        value = params[parameter.name]
        if not parameter.low <= value <= parameter.high:
            return (
                f"{name}.{parameter.name} = {value:g}: must be {parameter.low:g} to {parameter.high:g} {parameter.unit}"
            )
    return None


def _downwash_params(value: Mapping[str, float]) -> dict[str, float]:
    near = (value["prop_radius"] / (4.0 * BELOW)) ** 2
    return {"force": value["dw_coeff_1"] * near, "sigma": value["dw_coeff_2"] * BELOW + value["dw_coeff_3"]}


_Rule = Callable[[Mapping[str, float]], dict[str, float]]

_EFFECTS: tuple[tuple[str, tuple[str, ...], _Rule], ...] = (
    ("ground_effect", ("gnd_eff_coeff", "prop_radius"), lambda value: {"k": value["gnd_eff_coeff"]}),
    ("h_force_flapping", ("drag_coeff_xy",), lambda value: {"kh": value["drag_coeff_xy"], "kf": 0.0}),
    ("axial_inflow", ("drag_coeff_z",), lambda value: {"ka": value["drag_coeff_z"]}),
    ("h_force_flapping", ("drag_coeff",), lambda value: {"kh": value["drag_coeff"], "kf": 0.0}),
    ("axial_inflow", ("drag_coeff",), lambda value: {"ka": value["drag_coeff"]}),
    ("downwash", ("dw_coeff_1", "dw_coeff_2", "dw_coeff_3", "prop_radius"), _downwash_params),
)
"""Effects, the attributes that each needs, and its parameters."""


_SHAPE: file_vehicle.Tags = {"origin": {}, "geometry": {kind: {} for kind in ("box", "sphere", "cylinder", "mesh")}}
_JOINT: file_vehicle.Tags = {tag: {} for tag in ("origin", "parent", "child", "axis")}
_MOVING: file_vehicle.Tags = {tag: {} for tag in ("limit", "dynamics")}

_OFF = ("true", "1")


def read_urdf_vehicle(
    path: Path, rotor_links: str, lag: float | None, *, take_properties: bool, joints: bool = False
) -> file_vehicle.FileVehicle:
    """Return the vehicle of a URDF file.

    Args:
        rotor_links: Regular expression of names of links at whose centres of mass (at whose origins, where the file gives
            none) rotors push along z, for files without motors.
        joints: Whether revolute, continuous and prismatic joints move, but those of rotors and those that mimic another.
    """
    body, robot = urdf_body(path), read_urdf(path)
    poses = link_poses(robot)
    root = file_vehicle.read_xml(path)
    where = f"URDF {path.name}"
    plugins = [("", plugin) for plugin in root.iter("plugin")]
    motors = read_motors(plugins, where)
    names = [] if motors else [name for name in robot.link_map if re.fullmatch(rotor_links, name)]
    spun = {motor.joint for motor in motors}
    spun |= {joint.name for joint in robot.joint_map.values() if joint.child in names and joint.type == "continuous"}
    moving, on, notes = _find_joints(robot, poses, spun, where) if joints else ([], dict.fromkeys(poses, BASE), [])
    told = read_properties(root, body.mass, len(names) if take_properties else 0, lag, where)
    rotors = [_rotor_of_motor(motor, robot, poses, on, where) for motor in motors]
    rotors += [
        file_vehicle.FileRotor(
            name=n,
            position=_mass_centre_of_links(robot, [n], poses),
            axis=poses[n][:3, 2],
            rotor=told.rotor,
            link=on[n],
        )
        for n in names
    ]
    moves = {joint.name for joint in moving}
    held = {"fixed"} if _has_inner_floating_joint(robot) else {"fixed", "floating"}
    welded = [j for j in robot.joint_map.values() if j.type not in held and j.name not in spun and j.name not in moves]
    losses = [loss for _, plugin in plugins if (loss := force_source_to_omit(plugin)) is not None]
    tilting = {joint.name: _rotors_on_joint(joint, rotors, robot, poses) for joint in welded}
    still = [joint.name for joint in welded if not tilting[joint.name]]
    sideways = sideways_drag_effect(motors)
    return file_vehicle.FileVehicle(
        body=body,
        rotors=rotors,
        shapes=_collision_shapes(path, list(robot.link_map), on),
        joints=file_vehicle.joint_configs(moving),
        weightless=_links_without_gravity(root, robot, poses, on),
        effects={**sideways, **told.effects},
        effects_source=f"{where}: rotorDragCoefficient" if sideways else told.source,
        notes=(
            *motor_notes(motors),
            *notes,
            *told.notes,
            *([f"joints that are welded: {', '.join(still)}"] if still and not joints else []),
            *_unread_elements(root, joints=joints),
        ),
        assumed=(*motor_assumptions(motors), *told.assumed),
        losses=(
            *losses,
            *(f"joint {name}, which moves {', '.join(of)}, is welded" for name, of in tilting.items() if of),
        ),
    )


def _unread_elements(root: ElementTree.Element, *, joints: bool) -> Iterator[str]:
    """Yield the unused elements; visual shapes count only on links without collision shapes."""
    used: file_vehicle.Tags = {
        "link": {"inertial": {tag: {} for tag in ("origin", "mass", "inertia")}, "collision": _SHAPE, "visual": _SHAPE},
        "joint": {**_JOINT, **(_MOVING if joints else {})},
        "gazebo": {"plugin": MOTOR_TAGS, "turnGravityOff": {}, "gravity": {}},
        "properties": {},
    }
    seen = [v for link in root.iter("link") if link.find("collision") is not None for v in link.findall("visual")]
    rest = [plugin for plugin in root.iter("plugin") if not is_motor(plugin)]
    named = [plugin for plugin in rest if force_source_to_omit(plugin) is not None]
    yield from file_vehicle.unread_elements(root, used, left_out=[*seen, *rest], named=named)


def _has_inner_floating_joint(robot: "URDF") -> bool:
    """Return whether a floating joint is within the vehicle: one below a root without mass is its free flight."""
    parents = [robot.link_map[joint.parent] for joint in robot.joint_map.values() if joint.type == "floating"]
    children = {joint.child for joint in robot.joint_map.values()}
    return any(link.name in children or (link.inertial is not None and link.inertial.mass) for link in parents)


def _links_without_gravity(
    root: ElementTree.Element, robot: "URDF", poses: dict[str, np.ndarray], on: dict[str, str]
) -> list[file_vehicle.WeightlessMass]:
    """Return the links whose weight Gazebo leaves out."""
    results = []
    for name, link in robot.link_map.items():
        texts = [e for e in root.findall("gazebo") if e.get("reference") == name]
        off = any((e.findtext("turnGravityOff") or "").strip().lower() in _OFF for e in texts)
        off |= any((e.findtext("gravity") or "1").strip().lower() not in _OFF for e in texts)
        if off and link.inertial is not None and link.inertial.mass:
            mass = float(link.inertial.mass)
            results.append(
                file_vehicle.WeightlessMass(
                    mass=mass, position=_mass_centre_of_links(robot, [name], poses), link=on[name]
                )
            )
    return results


def _rotor_of_motor(
    motor: Motor, robot: "URDF", poses: dict[str, np.ndarray], on: dict[str, str], where: str
) -> file_vehicle.FileRotor:
    """Return position and axis of a motor: centre of mass of its link with the links fixed to it, and the link's z axis."""
    if motor.link not in poses or motor.joint not in robot.joint_map:
        raise ConfigError(
            f"{where}: there is no link {motor.link!r} or no joint {motor.joint!r} for one of its motors. Known: "
            f"{', '.join((*poses, *robot.joint_map))}"
        )
    group = [motor.link]
    for link in group:  # grows while it is walked
        group += [j.child for j in robot.joint_map.values() if j.type == "fixed" and j.parent == link]
    return file_vehicle.FileRotor(
        name=motor.link, position=_mass_centre_of_links(robot, group, poses), axis=poses[motor.link][:3, 2],
        spin=motor.spin, rotor=motor.rotor, link=on[motor.link],
    )  # fmt: skip


def _rotors_on_joint(
    joint: "Joint", rotors: Sequence[file_vehicle.FileRotor], robot: "URDF", poses: dict[str, np.ndarray]
) -> list[str]:
    """Return the rotors whose thrust line a joint would move."""
    above = {other.child: other.parent for other in robot.joint_map.values()}
    axis = poses[joint.child][:3, :3] @ np.asarray(joint.axis, dtype=float)
    results = []
    for rotor in rotors:
        link: str | None = rotor.name
        while link is not None and link != joint.child:
            link = above.get(link)
        if link is not None and file_vehicle.moves_thrust_line(rotor, joint.type, axis, poses[joint.child][:3, 3]):
            results.append(rotor.name)
    return results


def _mass_centre_of_links(robot: "URDF", links: Sequence[str], poses: dict[str, np.ndarray]) -> np.ndarray:
    """Return the centre of mass of links [m], (3,), where simulators apply thrust; without mass the first link's origin."""
    inertials = [(robot.link_map[link].inertial, poses[link]) for link in links]
    frames = [
        (own.mass or 0.0, pose if own.origin is None else pose @ own.origin)
        for own, pose in inertials
        if own is not None
    ]
    mass = sum(weight for weight, _ in frames)
    if mass > 0.0:
        return sum((weight * frame[:3, 3] for weight, frame in frames), np.zeros(3)) / mass
    return (frames[0][1] if inertials[0][0] is not None else poses[links[0]])[:3, 3]


def _find_joints(
    robot: "URDF", poses: dict[str, np.ndarray], spun: set[str], where: str
) -> tuple[list[file_vehicle.FileJoint], dict[str, str], list[str]]:
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
    on = file_vehicle.joint_moving_each_link(
        list(poses), lambda link: (above[link].name, above[link].parent) if link in above else None, moving
    )
    weights: dict[str, list[file_vehicle.LinkMass]] = {}
    for name, link in robot.link_map.items():
        own = link.inertial
        if own is not None and own.mass:
            pose = poses[name] if own.origin is None else poses[name] @ own.origin
            inertia = np.zeros((3, 3)) if own.inertia is None else np.asarray(own.inertia, dtype=float)
            weights.setdefault(on[name], []).append(
                file_vehicle.LinkMass(mass=float(own.mass), pose=pose, inertia=inertia)
            )
    results, waiting = [], [joint for joint in robot.joint_map.values() if joint.name in moving]
    placed = {BASE}
    while waiting:
        joint = next(joint for joint in waiting if on[joint.parent] in placed)
        waiting.remove(joint)
        placed.add(joint.name)
        results.append(_file_joint(joint, poses[joint.child], on[joint.parent], weights.get(joint.name, [])))
    return results, on, notes


def _file_joint(
    joint: "Joint", pose: np.ndarray, parent: str, weights: list[file_vehicle.LinkMass]
) -> file_vehicle.FileJoint:
    limit, dynamics = joint.limit, joint.dynamics
    limits = None
    if joint.type != "continuous" and limit is not None and limit.lower is not None and limit.upper is not None:
        limits = float(limit.lower), float(limit.upper)
    return file_vehicle.FileJoint(
        name=joint.name, parent=parent, kind="prismatic" if joint.type == "prismatic" else "revolute",
        axis=pose[:3, :3] @ np.asarray(joint.axis, dtype=float), position=pose[:3, 3], limits=limits,
        damping=0.0 if dynamics is None else float(dynamics.damping or 0.0),
        friction=0.0 if dynamics is None else float(dynamics.friction or 0.0), weights=weights,
    )  # fmt: skip


def _collision_shapes(path: Path, names: list[str], on: dict[str, str]) -> list[CollisionShape]:
    """Return the collision shapes of all links, each on its link; none of a file without geometry."""
    if all(link == BASE for link in on.values()):
        return [file_vehicle.part_collision_shape(part) for part in _geometry_parts(path, {})]
    results = []
    for start in range(0, len(names), FIRST_INSTANCE_ID):  # semantic ids tell the links apart
        some = names[start : start + FIRST_INSTANCE_ID]
        ids = {name: k for k, name in enumerate(some)}
        for part in _geometry_parts(path, ids):
            if part.semantic_id is not None:
                results.append(replace(file_vehicle.part_collision_shape(part), link=on[some[part.semantic_id]]))
    return results


def _geometry_parts(path: Path, ids: dict[str, int]) -> tuple[PartCfg, ...]:
    try:
        return load_urdf(path, link_ids=ids).parts or ()
    except ConfigError as error:
        if "holds no geometry" in str(error):
            return ()
        raise
