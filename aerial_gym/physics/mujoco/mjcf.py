"""MJCF of trees of links for MuJoCo; a rigid vehicle is a tree without joints.

Names: bodies ``link0`` (the base), ``link1``, ...; joint k, ``joint0``, ..., moves link k + 1.
Frames: a body's origin is the link's. The base of a floating tree has a free joint; that of a tree on a stand is a mocap body
with a prescribed pose. Letters: E environments.
Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from aerial_gym.physics.articulated.tree import Links, Tree
from aerial_gym.physics.ground import LinkContacts
from aerial_gym.physics.mujoco.solid_bodies import ON_LINKS, TOLERANCE, add_solids, numbers
from aerial_gym.physics.solids import Solids

_JOINT_TYPES = {"revolute": "hinge", "prismatic": "slide"}

LEAST_RADIUS = 1e-9
"""Radius of a contact point without one [m], because MuJoCo's spheres need a size."""

IMPEDANCE_RATIO = 100.0
"""Ratio of frictional to normal impedance; a sticking contact creeps less by this factor."""


@dataclass(frozen=True, kw_only=True)
class Floor:
    """A horizontal plane, and the shapes of the vehicle that can touch it."""

    height: float  # Height of the plane [m], world; minus infinity without one
    spheres: Sequence[Sequence[float]]  # Centres x, y, z in the axes of the base, and radii [m]; 0 for a point
    friction: float  # Coulomb coefficient

    on_links: LinkContacts | None = None
    """Contacts of an articulated vehicle: links of the spheres, pairs of shapes, and obstacles."""

    @property
    def solids(self) -> Solids | None:
        """Obstacles with contact to links; None without any."""
        return None if self.on_links is None else self.on_links.solids


def write_mjcf(
    tree: Tree,
    links: Links,
    *,
    env: int = 0,
    gravity: float,
    dt: float,
    integrator: str = "Euler",
    floor: Floor | None = None,
    actuated: bool = False,
) -> str:
    """Return the MJCF of one environment.

    Without a floor MuJoCo computes neither collisions nor constraints.

    Args:
        links: Masses and inertias. MuJoCo refuses moving links without mass, and inertias whose largest principal moment is
            above the sum of the others.
        actuated: Whether there are controls: force and torque of each link at its origin, link axes, (L, 6), then the efforts
            of joints, (D,). With a floor there are sensors as well: the force of all links on the ground and on each part.
    """
    root = Element("mujoco")
    SubElement(root, "compiler", boundmass="0", boundinertia="0", balanceinertia="false")
    option = SubElement(root, "option", timestep=repr(dt), integrator=integrator, gravity=numbers((0.0, 0.0, -gravity)))
    flags = {"warmstart": "disable"}  # makes a step depend on its state only
    world = SubElement(root, "worldbody")
    if floor is None:
        flags |= {"contact": "disable", "constraint": "disable"}
    else:
        option.attrib |= {"cone": "elliptic", "impratio": repr(IMPEDANCE_RATIO)}
        if isfinite(floor.height):
            SubElement(world, "geom", name="ground", type="plane", size="0 0 1", pos=numbers((0.0, 0.0, floor.height)))
        _set_friction(root, floor.friction)
    SubElement(option, "flag", flags)
    bodies = [_add_body(world, tree, 0, links, env)]
    for k, joint in enumerate(tree.joints):
        bodies.append(_add_body(bodies[joint.parent], tree, k + 1, links, env))
    if floor is not None:
        _add_shapes(root, floor, bodies)
        if floor.solids is not None:
            add_solids(root, world, floor.solids, env)
            if floor.solids.moves:
                option.set("tolerance", repr(TOLERANCE))
    if actuated:
        _add_actuators(root, tree, bodies)
        if floor is not None:
            _add_sensors(root, floor)
    return ElementTree.tostring(root, encoding="unicode")


def _add_shapes(root: Element, floor: Floor, bodies: Sequence[Element]) -> None:
    """Enable contacts of spheres with the ground, and of shapes with obstacles and in the listed pairs, and no others."""
    on = floor.on_links
    for place, (x, y, z, radius) in enumerate(floor.spheres):
        body, size = bodies[0 if on is None else on.links[place]], repr(max(radius, LEAST_RADIUS))
        SubElement(body, "geom", type="sphere", pos=numbers((x, y, z)), size=size, contype="0")
    if on is None:
        return
    for place, shape in enumerate(on.shapes):
        (x, y, z, w), (_, _, along) = shape.attitude, shape.half
        kind, size = ("capsule", (shape.radius, along)) if along else ("sphere", (shape.radius,))
        if not shape.radius:
            kind, size = "box", shape.half
        attributes = {"pos": numbers(shape.center), "quat": numbers((w, x, y, z)), "size": numbers(size)}
        touches = "0" if on.solids is None else ON_LINKS
        SubElement(
            bodies[shape.link], "geom", attributes, name=f"shape{place}", type=kind, contype="0", conaffinity=touches
        )
    contact = SubElement(root, "contact")
    for one, other in on.pairs:
        friction = numbers((floor.friction, floor.friction, 0.0, 0.0, 0.0))
        SubElement(contact, "pair", geom1=f"shape{one}", geom2=f"shape{other}", condim="3", friction=friction)


def _add_sensors(root: Element, floor: Floor) -> None:
    """Add sensors for the force of all links on the ground, and on each part of an obstacle [N], world."""
    touched = [{"geom2": "ground"}] if isfinite(floor.height) else []
    if floor.solids is not None:
        touched += [{"body2": f"part{place}"} for place in range(floor.solids.part.shape[1])]
    sensors = SubElement(root, "sensor")
    for other in touched:
        SubElement(sensors, "contact", {"subtree1": "link0", "data": "force", "reduce": "netforce"} | other)


def _add_actuators(root: Element, tree: Tree, bodies: Sequence[Element]) -> None:
    actuator = SubElement(root, "actuator")
    for link, body in enumerate(bodies):
        SubElement(body, "site", name=f"link{link}")
        for axis in range(6):
            gear = numbers(float(axis == place) for place in range(6))
            SubElement(actuator, "general", site=f"link{link}", gear=gear)
    for k in range(tree.num_joints):
        SubElement(actuator, "general", joint=f"joint{k}")


def _add_body(parent: Element, tree: Tree, link: int, links: Links, env: int) -> Element:
    """Add the body of a link to its parent, with its joint."""
    body = SubElement(parent, "body", name=f"link{link}")
    body.set("simple", "false")  # keeps terms that are zero here, because numbers are written later
    if link:
        joint = tree.joints[link - 1]
        x, y, z, w = joint.attitude
        body.attrib |= {"pos": numbers(joint.position), "quat": numbers((w, x, y, z))}
        SubElement(body, "joint", name=f"joint{link - 1}", type=_JOINT_TYPES[joint.kind], axis=numbers(joint.axis))
    elif tree.floating:
        SubElement(body, "freejoint")
    else:
        body.set("mocap", "true")
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = links.inertia[env, link].tolist()
    SubElement(
        body,
        "inertial",
        pos=numbers(links.com[env, link].tolist()),
        mass=repr(float(links.mass[env, link])),
        fullinertia=numbers((xx, yy, zz, xy, xz, yz)),
    )
    return body


def _set_friction(root: Element, friction: float) -> None:
    """Set the friction of all shapes, without torsional friction; MuJoCo takes the larger value of two in contact."""
    SubElement(SubElement(root, "default"), "geom", friction=numbers((friction, 0.0, 0.0)), condim="3")
