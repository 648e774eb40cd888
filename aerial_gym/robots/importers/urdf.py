"""URDF files: links as one body, rotors from motor plugins for Gazebo or from links that are named like rotors."""

import re
from pathlib import Path
from xml.etree import ElementTree

from aerial_gym.assets.urdf import link_poses, load_urdf, read_urdf
from aerial_gym.assets.urdf_body import urdf_body
from aerial_gym.config.robot import CollisionShape
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.found import Found, FoundRotor, numbers
from aerial_gym.robots.importers.motors import motors_in, notes_on, sideways_effects
from aerial_gym.robots.importers.shapes import shape_of


def read(path: Path, rotor_links: str) -> Found:
    """Return the vehicle of a URDF file.

    Args:
        path: The file, expanded if it was a xacro.
        rotor_links: Regular expression of names of links at whose origins rotors push along z, for files without motors.
    """
    body, poses = urdf_body(path), link_poses(read_urdf(path))
    root = ElementTree.parse(path).getroot()
    motors, where = motors_in(root, f"URDF {path.name}"), f"URDF {path.name}"
    if not motors:
        names = [name for name in poses if re.fullmatch(rotor_links, name)]
        rotors = [FoundRotor(name=n, position=poses[n][:3, 3], axis=poses[n][:3, 2]) for n in names]
        return Found(body=body, rotors=rotors, shapes=_shapes(path))
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
        rotors.append(FoundRotor(name=motor.link, position=pose[:3, 3], axis=axis, spin=motor.spin, rotor=motor.rotor))
    return Found(
        body=body, rotors=rotors, shapes=_shapes(path), effects=sideways_effects(motors), notes=tuple(notes_on(motors))
    )


def _shapes(path: Path) -> list[CollisionShape]:
    """Return the collision shapes of all links; none of a file without geometry."""
    try:
        parts = load_urdf(path).parts or ()
    except ConfigError as error:
        if "holds no geometry" in str(error):
            return []
        raise
    return [shape_of(part) for part in parts]
