"""SDF files of Gazebo: links as one body at the poses of the file, rotors from motor plugins.

A pose is relative to the frame that it names, or else to that of the model (a link, a frame, a nested model) or of the child
link (a joint). ``model://NAME`` is looked for in the folder that holds the file's own.

Source: sdformat.org, "Pose frame semantics" (1.7 and later; older files name no frames, and mean the same).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from aerial_gym.assets.urdf_body import weld
from aerial_gym.config.robot import CollisionShape
from aerial_gym.config.shape import PartCfg, ShapeCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.found import Found, FoundRotor, numbers, pose_of, roll_pitch_yaw, vec3
from aerial_gym.robots.importers.motors import Motor, motors_in, notes_on, sideways_effects
from aerial_gym.robots.importers.shapes import shape_of

MODEL = "__model__"
"""Name of the frame of a model in SDF files."""


def read(path: Path) -> Found:
    """Return the vehicle of an SDF file."""
    root = ElementTree.parse(path).getroot()
    model = root.find("model") if root.find("model") is not None else root.find("world/model")
    if model is None:
        raise ConfigError(f"SDF {path}: must hold a <model>")
    where = f"SDF model {model.get('name')}"
    tree = _Model(where=where, folder=path.resolve().parent)
    tree.take(model, prefix="", into=MODEL)
    if not tree.links:
        raise ConfigError(f"{where}: no link has a name")
    from_root = np.linalg.inv(tree.pose(next(iter(tree.links))))
    found = ((name, link.find("inertial")) for name, link in tree.links.items())
    inertials = [(name, inertial) for name, inertial in found if inertial is not None]
    masses = [tree.value(inertial, "mass", name) for name, inertial in inertials]
    if not sum(masses) > 0.0:
        raise ConfigError(f"{where}: no link has a mass")
    poses = [from_root @ tree.pose(name) @ tree.own_pose(inertial, name) for name, inertial in inertials]
    motors = motors_in(root, where) or [m for other in tree.others for m in motors_in(other, where)]
    return Found(
        body=weld(masses, poses, [tree.inertia(inertial, name) for name, inertial in inertials]),
        rotors=[tree.rotor(motor, from_root) for motor in motors],
        shapes=list(tree.shapes(from_root)),
        effects=sideways_effects(motors),
        notes=(*notes_on(motors), *tree.notes),
    )


@dataclass
class _Model:
    """Links, joints and frames by their scoped names, each with the element that places it."""

    where: str
    folder: Path
    links: dict[str, ElementTree.Element] = field(default_factory=dict)
    joints: dict[str, ElementTree.Element] = field(default_factory=dict)
    others: list[ElementTree.Element] = field(default_factory=list)
    """Roots of included files."""

    notes: list[str] = field(default_factory=list)
    _places: dict[str, tuple[str, np.ndarray]] = field(default_factory=dict)
    """Frame: the frame that it is placed in, and its pose there."""

    def take(self, model: ElementTree.Element, *, prefix: str, into: str) -> None:
        """Take what a model holds, with the names scoped by ``prefix``; ``into`` names its own frame."""
        self._places.setdefault(into, ("", np.eye(4)))
        for child in model:
            name = prefix + child.get("name", "")
            if child.tag == "link":
                self.links[name] = child
                self._place(name, child, prefix, into)
            elif child.tag == "joint":
                self.joints[name] = child
                self._place(name, child, prefix, prefix + (child.findtext("child") or "").strip())
            elif child.tag == "frame":
                attached = child.get("attached_to")
                self._place(name, child, prefix, into if attached is None else prefix + attached)
            elif child.tag == "model":
                self._place(name, child, prefix, into)
                self.take(child, prefix=f"{name}::", into=name)
            elif child.tag == "include":
                self._include(child, prefix, into)

    def _include(self, include: ElementTree.Element, prefix: str, into: str) -> None:
        uri = (include.findtext("uri") or "").strip()
        folder = self.folder.parent / uri.removeprefix("model://")
        files = [file for file in (folder / "model.sdf", folder / f"{folder.name}.sdf", folder) if file.is_file()]
        if not files:
            raise ConfigError(
                f"{self.where}: includes {uri!r}, which is not in {self.folder.parent}. Put the folder of that model there, or "
                "take the include out of the file"
            )
        root = ElementTree.parse(files[0]).getroot()
        model = root.find("model")
        if model is None:
            raise ConfigError(f"{self.where}: includes {files[0]}, which holds no <model>")
        self.others.append(root)
        merged = include.get("merge") == "true"
        name = prefix + (include.findtext("name") or model.get("name", "")).strip()
        frame = f"{name}::{MODEL}" if merged else name
        self._place(frame, include if include.find("pose") is not None else model, prefix, into)
        self.take(model, prefix=prefix if merged else f"{name}::", into=frame)

    def _place(self, name: str, element: ElementTree.Element, prefix: str, default: str) -> None:
        pose = element.find("pose")
        to = None if pose is None else pose.get("relative_to")
        scoped = default if not to or to == MODEL else prefix + to
        self._places[name] = (scoped, self.own_pose(element, name))

    def own_pose(self, element: ElementTree.Element, name: str) -> np.ndarray:
        """Return the pose that an element gives, (4, 4)."""
        pose = element.find("pose")
        if pose is None:
            return np.eye(4)
        if pose.get("rotation_format", "euler_rpy") != "euler_rpy":
            raise ConfigError(
                f"{self.where}: {name}: poses with rotation_format {pose.get('rotation_format')!r} are not read"
            )
        values = numbers(pose.text, 6, f"{self.where}: pose of {name}")
        angles = [radians(a) for a in values[3:]] if pose.get("degrees") == "true" else values[3:]
        return pose_of(values[:3], angles)

    def pose(self, name: str) -> np.ndarray:
        """Return a frame in that of the outermost model, (4, 4)."""
        pose, seen = np.eye(4), []
        while name:
            if name in seen or name not in self._places:
                way = " -> ".join((*seen, name))
                raise ConfigError(f"{self.where}: frame {name!r} is not there, or is placed in itself: {way}")
            seen.append(name)
            name, own = self._places[name]
            pose = own @ pose
        return pose

    def value(self, element: ElementTree.Element, tag: str, name: str) -> float:
        """Return one number of an element, 0 where there is none."""
        return numbers(element.findtext(tag), 1, f"{self.where}: {tag} of {name}")[0]

    def inertia(self, inertial: ElementTree.Element, name: str) -> np.ndarray:
        """Return the inertia of a link about its centre of mass, (3, 3)."""
        own = inertial.find("inertia")
        if own is None:
            return np.zeros((3, 3))
        xx, xy, xz, yy, yz, zz = (self.value(own, tag, name) for tag in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def rotor(self, motor: Motor, from_root: np.ndarray) -> FoundRotor:
        """Return where a motor pushes: at the centre of mass of its link, along the axis of its joint."""
        link, joint = self.links.get(motor.link), self.joints.get(motor.joint)
        axis = None if joint is None else joint.find("axis/xyz")
        if link is None or joint is None or axis is None:
            raise ConfigError(
                f"{self.where}: there is no link {motor.link!r}, or no joint {motor.joint!r} with an axis, for a motor"
            )
        along = np.array(numbers(axis.text, 3, f"{self.where}: axis of {motor.joint}"))
        frame = axis.get("expressed_in") or motor.joint
        if (joint.findtext("axis/use_parent_model_frame") or "").strip() in ("1", "true"):
            frame = MODEL
        inertial = link.find("inertial")
        centre = (
            self.pose(motor.link) if inertial is None else self.pose(motor.link) @ self.own_pose(inertial, motor.link)
        )
        return FoundRotor(
            name=motor.link,
            position=(from_root @ centre)[:3, 3],
            axis=(from_root @ self.pose(frame))[:3, :3] @ along,
            spin=motor.spin,
            rotor=motor.rotor,
        )

    def shapes(self, from_root: np.ndarray) -> Iterator[CollisionShape]:
        """Yield the collision shapes of all links; meshes and planes are left out, and noted."""
        for name, link in self.links.items():
            for collision in link.findall("collision"):
                pose = from_root @ self.pose(name) @ self.own_pose(collision, name)
                shape = self._geometry(collision, name)
                if shape is not None:
                    yield shape_of(PartCfg(shape=shape, position=vec3(pose[:3, 3]), euler=roll_pitch_yaw(pose[:3, :3])))

    def _geometry(self, collision: ElementTree.Element, name: str) -> ShapeCfg | None:
        found = next(iter(collision.find("geometry") or ()), None)
        if found is None or found.tag not in ("sphere", "box", "cylinder", "capsule"):
            kind = "none" if found is None else found.tag
            self.notes.append(f"the collision shape of {name} is left out: {kind}")
            return None
        if found.tag == "box":
            return ShapeCfg(kind="box", size=vec3(numbers(found.findtext("size"), 3, f"{self.where}: box of {name}")))
        radius = self.value(found, "radius", name)
        height = None if found.tag == "sphere" else self.value(found, "length", name)
        return ShapeCfg(kind=found.tag, radius=radius, height=height)
