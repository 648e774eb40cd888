"""Links, joints, frames and plugins of an SDF model, of the models nested in it, and of those that it includes.

A pose is relative to the frame that it names. Its default is the model's frame for a link, a frame or a nested model, the
link's frame for a collision, and the child's frame for a joint. Names within a nested model ``m`` are scoped: ``m::link``.
``model://NAME`` is looked for in the folder that holds the file's own, other addresses in the file's own folder.

Source: sdformat.org, "Pose frame semantics" and "Model composition" (1.7 and later; older files name no frames, and mean the
same).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.file_vehicle import make_pose, parse_numbers, read_xml

Element = ElementTree.Element

MODEL = "__model__"  # Name of the frame of a model in SDF files

TRUE = ("true", "1")


@dataclass(frozen=True)
class Scope:
    """Model that contains an element."""

    prefix: str  # Put before the names that it uses
    frame: str  # Name of the model's own frame
    folder: Path  # Of the file


@dataclass(frozen=True)
class _FramePlace:
    base: str  # Frame that it is placed in; none of the outermost model
    pose: np.ndarray
    placement: str | None = None  # Frame of a model to which its pose applies, in place of its own


@dataclass
class SdfTree:
    """Everything of a model by scoped names."""

    where: str
    links: dict[str, Element] = field(default_factory=dict)
    joints: dict[str, Element] = field(default_factory=dict)
    plugins: list[tuple[str, Element]] = field(default_factory=list)  # Each with the scope of its names
    scopes: dict[str, Scope] = field(default_factory=dict)  # Of links and joints
    roots: list[Element] = field(default_factory=list)  # Of included files
    _within: list[Path] = field(default_factory=list)  # Files that include the present one
    _places: dict[str, _FramePlace] = field(default_factory=dict)
    _attached: dict[str, str] = field(default_factory=dict)  # Element or canonical link of each frame

    def add_model(self, model: Element, scope: Scope) -> None:
        """Add the content of a model, and its own frame if it has none yet."""
        self._places.setdefault(scope.frame, _FramePlace("", np.eye(4)))
        before = list(self.links)
        for child in model:
            name = scope.prefix + child.get("name", "")
            if child.tag == "link":
                self.links[name], self.scopes[name] = child, scope
                self._add_frame(name, child, scope, scope.frame)
            elif child.tag == "joint":
                self.joints[name], self.scopes[name] = child, scope
                self._add_frame(name, child, scope, self.full_name(child.findtext("child"), scope))
            elif child.tag == "frame":
                to = self.full_name(child.get("attached_to") or MODEL, scope)
                self._attached[name] = to
                self._add_frame(name, child, scope, to)
            elif child.tag == "plugin":
                self.plugins.append((scope.prefix, child))
            elif child.tag == "model":
                self._add_nested_model(child, child, Scope(f"{name}::", name, scope.folder), scope)
            elif child.tag == "include":
                self._add_included_model(child, scope)
        self._attached.setdefault(scope.frame, self._canonical_link(model, scope, before))

    def full_name(self, name: str | None, scope: Scope) -> str:
        """Return the full name, in the outermost model, of a name within a scope."""
        own = (name or "").strip()
        if own == MODEL:
            return scope.frame
        return scope.prefix + own.removesuffix(f"::{MODEL}")

    def _canonical_link(self, model: Element, scope: Scope, before: list[str]) -> str:
        """Return the canonical link of a model: the named one, its first own one, or that of a nested model."""
        if model.get("canonical_link"):
            return self.full_name(model.get("canonical_link"), scope)
        new = [name for name in self.links if name not in before]
        own = [name for name in new if "::" not in name.removeprefix(scope.prefix)]
        return next(iter((*own, *new)), "")

    def _add_nested_model(self, model: Element, placed: Element, inner: Scope, scope: Scope) -> None:
        """Add a model nested in another one, at the pose of ``placed``: itself, or the element that includes it."""
        self._add_frame(inner.frame, placed, scope, scope.frame, _placement_frame(placed, model, inner))
        self.add_model(model, inner)

    def _add_included_model(self, include: Element, scope: Scope) -> None:
        file = _find_file((include.findtext("uri") or "").strip(), scope.folder, self.where)
        root = read_xml(file)
        model = root.find("model")
        if model is None:
            raise ConfigError(f"{self.where}: includes {file}, which holds no <model>")
        if file in self._within:
            raise ConfigError(f"{self.where}: {file} includes itself. Take the include out of it")
        self._within.append(file)
        self.roots.append(root)
        name = scope.prefix + (include.findtext("name") or model.get("name", "")).strip()
        inner = Scope(f"{name}::", name, file.parent)
        if include.get("merge") in TRUE:
            inner = Scope(scope.prefix, f"{name}::{MODEL}", file.parent)
        self._add_nested_model(model, include if include.find("pose") is not None else model, inner, scope)
        self._within.pop()
        self.plugins += [(inner.prefix, plugin) for plugin in include.findall("plugin")]

    def _add_frame(self, name: str, element: Element, scope: Scope, default: str, placement: str | None = None) -> None:
        base, pose = self._frame_and_pose(element, name, scope, default)
        self._places[name] = _FramePlace(base, pose, placement)

    def _frame_and_pose(self, element: Element, name: str, scope: Scope, default: str) -> tuple[str, np.ndarray]:
        """Return the reference frame of an element and its pose there."""
        pose = element.find("pose")
        if pose is None:
            return default, np.eye(4)
        to = pose.get("relative_to") or pose.get("frame")
        return self.full_name(to, scope) if to else default, read_pose(pose, f"{self.where}: pose of {name}")

    def pose(self, name: str, within: str = "") -> np.ndarray:
        """Return the pose of a frame in the outermost model or in another frame, (4, 4)."""
        pose, seen = np.eye(4), []
        while name != within:
            if name in seen or name not in self._places:
                way = " -> ".join((*seen, name))
                raise ConfigError(f"{self.where}: frame {name!r} is not there, or is placed in itself: {way}")
            seen.append(name)
            place = self._places[name]
            placed = np.eye(4) if place.placement is None else np.linalg.inv(self.pose(place.placement, within=name))
            pose = place.pose @ placed @ pose
            name = place.base
        return pose

    def pose_in_link(self, element: Element, link: str) -> np.ndarray:
        """Return a collision or inertial frame of a link in the outermost model's, (4, 4)."""
        base, pose = self._frame_and_pose(element, link, self.scopes[link], link)
        return self.pose(base) @ pose

    def find_link(self, name: str) -> str | None:
        """Return the link of a joint's parent or child, which may be a link, a frame or a model; None for the world."""
        seen: list[str] = []
        while name not in self.links:
            if name in seen or name not in self._attached:
                return None
            seen.append(name)
            name = self._attached[name]
        return name

    def joint_ends(self, joint: str) -> tuple[str | None, str | None]:
        """Return parent and child link of a joint; None for the world."""
        element, scope = self.joints[joint], self.scopes[joint]
        parent, child = (self.find_link(self.full_name(element.findtext(tag), scope)) for tag in ("parent", "child"))
        return parent, child

    @property
    def root_link(self) -> str:
        """Name of the link whose frame becomes the body's: the canonical one of the outermost model."""
        name = self.find_link(MODEL)
        if name is None:
            raise ConfigError(f"{self.where}: no link has a name, or the canonical link is not there")
        return name

    def joint_axis(self, joint: str) -> np.ndarray:
        """Return the axis of a joint in the outermost model's frame, (3,)."""
        element, scope, frame = self.joints[joint].find("axis"), self.scopes[joint], joint
        if element is None:
            return self.pose(joint)[:3, 2]
        xyz = element.find("xyz")
        if (element.findtext("use_parent_model_frame") or "").strip() in TRUE:
            frame = scope.frame
        elif xyz is not None and xyz.get("expressed_in"):
            frame = self.full_name(xyz.get("expressed_in"), scope)
        along = parse_numbers("0 0 1" if xyz is None else xyz.text, 3, f"{self.where}: axis of {joint}")
        return self.pose(frame)[:3, :3] @ np.array(along)

    def mesh_file(self, uri: str, link: str) -> Path:
        """Return the file of a mesh of a link."""
        return _find_file(uri, self.scopes[link].folder, self.where)


def _placement_frame(placed: Element, model: Element, inner: Scope) -> str | None:
    """Return the frame that a model's pose refers to; None for its own."""
    name = placed.findtext("placement_frame") or model.get("placement_frame")
    return None if name is None or name.strip() == MODEL else inner.prefix + name.strip()


def read_pose(pose: Element, where: str) -> np.ndarray:
    """Return a frame (4, 4) from a <pose>: place and ZYX angles in radians or degrees, or place and quaternion xyzw."""
    from trimesh.transformations import quaternion_matrix

    kind, degrees = pose.get("rotation_format", "euler_rpy"), pose.get("degrees", "").lower() in TRUE
    if kind == "quat_xyzw" and not degrees:
        x, y, z, *quaternion = parse_numbers(pose.text or "0 0 0 0 0 0 1", 7, where)
        if not np.linalg.norm(quaternion) > 0.0:
            raise ConfigError(f"{where} = {pose.text!r}: the quaternion is 0: give a turn, 0 0 0 1 for none")
        turned = quaternion_matrix([quaternion[3], *quaternion[:3]])
        turned[:3, 3] = x, y, z
        return turned
    if kind != "euler_rpy":
        raise ConfigError(
            f"{where}: rotation_format {kind!r}: must be euler_rpy, in radians or degrees, or quat_xyzw without degrees"
        )
    values = parse_numbers(pose.text, 6, where)
    return make_pose(values[:3], [radians(a) for a in values[3:]] if degrees else values[3:])


def _find_file(uri: str, folder: Path, where: str) -> Path:
    """Return the file that an address means: of a model, its model.sdf or NAME.sdf."""
    files = list(_candidate_files(uri, folder))
    if not files:
        raise ConfigError(
            f"{where}: includes {uri!r}, which is not in {folder.parent}. Put the folder of that model there, or take the "
            "element out of the file"
        )
    return files[0]


def _candidate_files(uri: str, folder: Path) -> Iterator[Path]:
    base = folder.parent if uri.startswith("model://") else folder
    rest = uri.removeprefix("model://").removeprefix("file://")
    for path in (base / rest, folder.parent / rest, folder / rest):
        for file in (path / "model.sdf", path / f"{path.name}.sdf", path):
            if rest and file.is_file():
                yield file
