"""SDF files of Gazebo: links as one body at the poses of the file, rotors from motor plugins.

Every joint is welded. One that carries a rotor and moves its thrust line is a loss, as are plugins of wings.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from aerial_gym.assets.urdf import weld
from aerial_gym.config.robot import BoxCfg, CollisionShape
from aerial_gym.config.shape import PartCfg, ShapeCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers import sdf_inertia
from aerial_gym.robots.importers.file_vehicle import (
    FileRotor,
    FileVehicle,
    LinkMass,
    Tags,
    WeightlessMass,
    euler_of_matrix,
    group_lines_by_kind,
    moves_thrust_line,
    part_collision_shape,
    read_xml,
    round_vec3,
    unread_elements,
)
from aerial_gym.robots.importers.motors import (
    MOTOR_TAGS,
    Motor,
    force_source_to_omit,
    is_motor,
    motor_notes,
    read_motors,
    sideways_drag_effect,
)
from aerial_gym.robots.importers.motors import motor_assumptions as motors_assumed
from aerial_gym.robots.importers.sdf_tree import MODEL, TRUE, Element, Scope, SdfTree

_MODEL: dict[str, Tags] = {
    "pose": {},
    "link": {
        "pose": {},
        "gravity": {},
        "inertial": {
            **{tag: {} for tag in ("pose", "mass", "density")},
            "inertia": {f"i{axes}": {} for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
        },
        "collision": {
            **{tag: {} for tag in ("pose", "density")},
            "geometry": {
                **{kind: {tag: {} for tag in tags} for kind, tags in sdf_inertia.SIZES.items()},
                "mesh": {"uri": {}, "scale": {}},
            },
        },
    },
    "joint": {"pose": {}, "parent": {}, "child": {}, "axis": {"xyz": {}, "use_parent_model_frame": {}}},
    "frame": {"pose": {}},
    "plugin": MOTOR_TAGS,
    "include": {**{tag: {} for tag in ("uri", "name", "pose", "placement_frame")}, "plugin": MOTOR_TAGS},
}
_MODEL["model"] = _MODEL  # Elements of a model that are read


def read_sdf(path: Path) -> FileVehicle:
    """Return the vehicle of an SDF file: the model with motors, or the first one."""
    root = read_xml(path)
    tree, vehicle = _find_vehicle(root, path)
    weights = {name: sdf_inertia.link_weight(tree, name) for name in tree.links}
    if not sum(weight.mass for weight in weights.values()) > 0.0:
        raise ConfigError(f"{tree.where}: no link has a mass")
    from_root = np.linalg.inv(tree.pose(tree.root_link))
    poses = [from_root @ weight.pose for weight in weights.values()]
    motors = read_motors(tree.plugins, tree.where)
    rotors = [_file_rotor(tree, motor, weights, from_root) for motor in motors]
    reader = _SdfReader(tree, from_root, {motor.joint for motor in motors}, rotors)
    shapes = list(reader.shapes())
    effects = sideways_drag_effect(motors)
    return FileVehicle(
        body=weld([weight.mass for weight in weights.values()], poses, [weight.inertia for weight in weights.values()]),
        rotors=rotors,
        shapes=shapes,
        weightless=[
            WeightlessMass(mass=weights[name].mass, position=pose[:3, 3])
            for name, pose in zip(weights, poses, strict=True)
            if (tree.links[name].findtext("gravity") or "1").strip().lower() not in TRUE
        ],
        effects=effects,
        effects_source=f"{tree.where}: rotorDragCoefficient" if effects else "",
        notes=(*motor_notes(motors), *reader.lines_on_unused(), *_unread_elements(root, vehicle, tree)),
        assumed=(
            *motors_assumed(motors),
            *group_lines_by_kind(
                (label, name) for name in tree.links for label in sdf_inertia.link_assumptions(tree, name)
            ),
            *reader.loose_links(),
        ),
        losses=tuple(reader.parts_lost()),
    )


def _find_vehicle(root: Element, path: Path) -> tuple[SdfTree, Element]:
    """Return the model that is the vehicle, and its element: the first one with motors, else the first."""
    known = [child for base in (root, *root.findall("world")) for child in base if child.tag in ("model", "include")]
    models, refusal = [], None
    for element in known:
        try:
            models.append((_read_tree(element, path), element))
        except ConfigError as error:  # a ground plane of a server, beside the vehicle
            refusal = refusal or error
    with_motors = [pair for pair in models if any(is_motor(plugin) for _, plugin in pair[0].plugins)]
    if not with_motors and (refusal is not None or not models):
        raise refusal or ConfigError(f"SDF {path}: must hold a <model>")
    return (with_motors or models)[0]


def _read_tree(element: Element, path: Path) -> SdfTree:
    model = element
    if element.tag == "include":
        model = ElementTree.Element("model", name=(element.findtext("name") or element.findtext("uri") or "").strip())
        merged = ElementTree.SubElement(model, "include", {**element.attrib, "merge": "true"})
        merged.extend(element)
    tree = SdfTree(where=f"SDF model {model.get('name')}")
    tree.add_model(model, Scope("", MODEL, path.resolve().parent))
    if not tree.links:
        raise ConfigError(f"{tree.where}: no link has a name")
    return tree


def _file_rotor(tree: SdfTree, motor: Motor, weights: dict[str, LinkMass], from_root: np.ndarray) -> FileRotor:
    """Return position and axis of a motor: centre of mass and z axis of its link."""
    if motor.link not in tree.links or motor.joint not in tree.joints:
        raise ConfigError(
            f"{tree.where}: there is no link {motor.link!r}, or no joint {motor.joint!r}, for a motor. Known: "
            f"{', '.join((*tree.links, *tree.joints))}"
        )
    return FileRotor(
        name=motor.link, position=(from_root @ weights[motor.link].pose)[:3, 3],
        axis=(from_root @ tree.pose(motor.link))[:3, 2], spin=motor.spin, rotor=motor.rotor,
    )  # fmt: skip


def _unread_elements(root: Element, vehicle: Element, tree: SdfTree) -> Iterator[str]:
    """Yield the unused elements of the file."""
    rest = [child for base in (root, *root.findall("world")) for child in base if child is not vehicle]
    plugins = [plugin for _, plugin in tree.plugins if not is_motor(plugin) and force_source_to_omit(plugin) is None]
    named = [plugin for _, plugin in tree.plugins if force_source_to_omit(plugin) is not None]
    used = {"model": _MODEL, "include": _MODEL["include"]}
    yield from unread_elements(
        root, {**used, "world": used}, left_out=[*plugins, *(o for o in rest if o.tag in used)], named=named
    )
    for included in tree.roots:
        yield from unread_elements(included, used, left_out=plugins, named=named)


@dataclass
class _SdfReader:
    """Joints and shapes of a model in the frame of its root link."""

    tree: SdfTree
    from_root: np.ndarray
    spun: set[str]  # Joints of motors
    rotors: Sequence[FileRotor]

    def __post_init__(self) -> None:
        self._unread: list[str] = []
        self._ends = {joint: self.tree.joint_ends(joint) for joint in self.tree.joints}
        self._ways = self._joints_to_links()
        self._tilting: dict[str, list[str]] = {}
        for rotor in self.rotors:
            for joint in filter(self._tilt_test(rotor), self._ways.get(rotor.name, [])):
                self._tilting.setdefault(joint, []).append(rotor.name)

    def _joints_to_links(self) -> dict[str, list[str]]:
        """Return the joints between the root and each link that is joined to it, whichever of two links is the child."""
        ways: dict[str, list[str]] = {self.tree.root_link: []}
        for at in (waiting := [self.tree.root_link]):  # grows while it is walked
            for joint, (parent, child) in self._ends.items():
                other = child if at == parent else parent
                if at in (parent, child) and other is not None and other not in ways:
                    ways[other] = [*ways[at], joint]
                    waiting.append(other)
        return ways

    def _is_moving(self, joint: str) -> bool:
        return self.tree.joints[joint].get("type") != "fixed" and joint not in self.spun

    def _tilt_test(self, rotor: FileRotor) -> Callable[[str], bool]:
        """Return the test of whether a joint on the way to a rotor moves its thrust line."""

        def tilts_rotor(joint: str) -> bool:
            axis = self.from_root[:3, :3] @ self.tree.joint_axis(joint)
            place = (self.from_root @ self.tree.pose(joint))[:3, 3]
            return moves_thrust_line(rotor, self.tree.joints[joint].get("type", ""), axis, place)

        return lambda joint: self._is_moving(joint) and tilts_rotor(joint)

    def parts_lost(self) -> Iterator[str]:
        """Yield the wings and joints that the import loses."""
        yield from filter(None, (force_source_to_omit(plugin) for _, plugin in self.tree.plugins))
        for joint, names in self._tilting.items():
            yield f"joint {joint}, which moves {', '.join(names)}, is welded"

    def lines_on_unused(self) -> Iterator[str]:
        """Yield the unused data of joints, links and shapes."""
        if welded := [joint for joint in self.tree.joints if self._is_moving(joint) and joint not in self._tilting]:
            yield f"joints that are welded: {', '.join(welded)}"
        if held := [joint for joint, ends in self._ends.items() if None in ends]:
            yield f"joints to the world: {', '.join(held)}"
        if self._unread:
            yield f"collision meshes: {', '.join(self._unread)}"
        yield from group_lines_by_kind(
            (label, name) for name in self.tree.links for label in sdf_inertia.list_ignored_numbers(self.tree, name)
        )

    def loose_links(self) -> Iterator[str]:
        """Yield the links that no joint connects with the root."""
        if loose := [name for name in self.tree.links if name not in self._ways]:
            yield f"links without a joint, welded to the others: {', '.join(loose)}"

    def shapes(self) -> Iterator[CollisionShape]:
        """Yield the collision shapes of all links, with bounding boxes in place of unsupported shapes."""
        for name, link in self.tree.links.items():
            for collision in link.findall("collision"):
                pose = self.from_root @ self.tree.pose_in_link(collision, name)
                shape = self._collision_shape(collision, name, pose)
                if shape is not None:
                    yield shape

    def _collision_shape(self, collision: Element, link: str, pose: np.ndarray) -> CollisionShape | None:
        geometry = sdf_inertia.collision_shape(collision)
        at = f"{self.tree.where}: collision of {link}"
        if geometry is None or geometry.tag not in (*sdf_inertia.SIZES, "mesh"):
            return None
        if geometry.tag == "mesh":
            return self._box_around_mesh(geometry, collision, link, pose)
        sizes = sdf_inertia.shape_lengths(geometry, at)
        if geometry.tag in ("ellipsoid", "cone"):
            around = (
                [2.0 * r for r in sizes] if geometry.tag == "ellipsoid" else [2.0 * sizes[0], 2.0 * sizes[0], sizes[1]]
            )
            return _box_in_frame(pose, np.zeros(3), np.array(around))
        shape = (
            ShapeCfg(kind="box", size=round_vec3(sizes))
            if geometry.tag == "box"
            else ShapeCfg(kind=geometry.tag, radius=sizes[0], height=None if geometry.tag == "sphere" else sizes[1])
        )
        return part_collision_shape(
            PartCfg(shape=shape, position=round_vec3(pose[:3, 3]), euler=euler_of_matrix(pose[:3, :3]))
        )

    def _box_around_mesh(
        self, shape: Element, collision: Element, link: str, pose: np.ndarray
    ) -> CollisionShape | None:
        try:
            low, high = sdf_inertia.load_collision_mesh(self.tree, link, shape).bounds
            return _box_in_frame(pose, 0.5 * (low + high), high - low)
        except ConfigError as error:  # the hull of a model is often a file of its own, which is not at hand
            self._unread.append(f"{collision.get('name')} ({error})")
            return None


def _box_in_frame(pose: np.ndarray, center: np.ndarray, size: np.ndarray) -> BoxCfg:
    """Return a box whose centre is given in a frame."""
    place = pose[:3, :3] @ center + pose[:3, 3]
    return BoxCfg(center=round_vec3(place), size=round_vec3(size), euler=euler_of_matrix(pose[:3, :3]))
