"""Trees of links as MuJoCo reads them (MJCF); a rigid vehicle is a tree without joints.

Names: bodies ``link0`` (the base), ``link1``, ...; joint k, ``joint0``, ..., moves link k + 1.
Frames: a body's origin is the link's; the base of a floating tree has a free joint. Letters: E environments.
Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from aerial_gym.physics.articulated.tree import Links, Tree
from aerial_gym.physics.ground import LinkShapes

_JOINT_TYPES = {"revolute": "hinge", "prismatic": "slide"}

LEAST_RADIUS = 1e-9
"""In place of the radius of a contact point that has none [m]: MuJoCo's spheres have a size."""

IMPEDANCE_RATIO = 100.0
"""How much harder friction is than the normal force: what sticks creeps by so much less."""


@dataclass(frozen=True, kw_only=True)
class Floor:
    """A horizontal plane and what of the base can touch it."""

    height: float
    """Of the plane [m], world."""

    spheres: Sequence[Sequence[float]]
    """Centres x, y, z in the axes of the base and radii [m]; a radius of zero is a point."""

    friction: float
    """Coulomb coefficient."""

    on_links: LinkShapes | None = None
    """Of a vehicle that bends: on which link each sphere is, and what of them pushes each other."""


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

    Without a floor nothing can touch anything, and MuJoCo leaves out collisions and constraints.

    Args:
        tree: How links hang together.
        links: What they weigh. MuJoCo takes no moving link without mass, and no inertia whose largest principal moment is more
            than the sum of the others.
        env: Whose row of ``links`` is written.
        gravity: Downward acceleration of free fall [m/s²].
        dt: Time step [s].
        integrator: Of MuJoCo's: ``Euler`` (semi-implicit), ``RK4``, ``implicit``, ``implicitfast``.
        floor: What can be touched.
        actuated: Whether controls push: force and torque of each link at its origin, in its axes, (L, 6), then the efforts of
            joints, (D,).
    """
    root = Element("mujoco")
    SubElement(root, "compiler", boundmass="0", boundinertia="0", balanceinertia="false")
    option = SubElement(
        root, "option", timestep=repr(dt), integrator=integrator, gravity=_numbers((0.0, 0.0, -gravity))
    )
    flags = {"warmstart": "disable"}  # a step depends on nothing but its state
    world = SubElement(root, "worldbody")
    if floor is None:
        flags |= {"contact": "disable", "constraint": "disable"}
    else:
        option.attrib |= {"cone": "elliptic", "impratio": repr(IMPEDANCE_RATIO)}
        SubElement(world, "geom", type="plane", size="0 0 1", pos=_numbers((0.0, 0.0, floor.height)))
        _set_friction(root, floor.friction)
    SubElement(option, "flag", flags)
    bodies = [_add_body(world, tree, 0, links, env)]
    for k, joint in enumerate(tree.joints):
        bodies.append(_add_body(bodies[joint.parent], tree, k + 1, links, env))
    if floor is not None:
        _add_shapes(root, floor, bodies)
    if actuated:
        _add_actuators(root, tree, bodies)
    return ElementTree.tostring(root, encoding="unicode")


def _add_shapes(root: Element, floor: Floor, bodies: Sequence[Element]) -> None:
    """Let spheres touch the ground and nothing else, and the shapes of pairs each other and nothing else."""
    on = floor.on_links
    for place, (x, y, z, radius) in enumerate(floor.spheres):
        body, size = bodies[0 if on is None else on.links[place]], repr(max(radius, LEAST_RADIUS))
        SubElement(body, "geom", type="sphere", pos=_numbers((x, y, z)), size=size, contype="0")
    if on is None:
        return
    for place, shape in enumerate(on.shapes):
        (x, y, z, w), (_, _, along) = shape.attitude, shape.half
        kind, size = ("capsule", (shape.radius, along)) if along else ("sphere", (shape.radius,))
        if not shape.radius:
            kind, size = "box", shape.half
        attributes = {"pos": _numbers(shape.center), "quat": _numbers((w, x, y, z)), "size": _numbers(size)}
        SubElement(
            bodies[shape.link], "geom", attributes, name=f"shape{place}", type=kind, contype="0", conaffinity="0"
        )
    contact = SubElement(root, "contact")
    for one, other in on.pairs:
        friction = _numbers((floor.friction, floor.friction, 0.0, 0.0, 0.0))
        SubElement(contact, "pair", geom1=f"shape{one}", geom2=f"shape{other}", condim="3", friction=friction)


def _add_actuators(root: Element, tree: Tree, bodies: Sequence[Element]) -> None:
    actuator = SubElement(root, "actuator")
    for link, body in enumerate(bodies):
        SubElement(body, "site", name=f"link{link}")
        for axis in range(6):
            gear = _numbers(float(axis == place) for place in range(6))
            SubElement(actuator, "general", site=f"link{link}", gear=gear)
    for k in range(tree.num_joints):
        SubElement(actuator, "general", joint=f"joint{k}")


def _add_body(parent: Element, tree: Tree, link: int, links: Links, env: int) -> Element:
    """Return the body of a link, hung on its parent by its joint."""
    body = SubElement(parent, "body", name=f"link{link}")
    body.set("simple", "false")  # MuJoCo would leave out what is zero here, and numbers are written later
    if link:
        joint = tree.joints[link - 1]
        x, y, z, w = joint.attitude
        body.attrib |= {"pos": _numbers(joint.position), "quat": _numbers((w, x, y, z))}
        SubElement(body, "joint", name=f"joint{link - 1}", type=_JOINT_TYPES[joint.kind], axis=_numbers(joint.axis))
    elif tree.floating:
        SubElement(body, "freejoint")
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = links.inertia[env, link].tolist()
    SubElement(
        body,
        "inertial",
        pos=_numbers(links.com[env, link].tolist()),
        mass=repr(float(links.mass[env, link])),
        fullinertia=_numbers((xx, yy, zz, xy, xz, yz)),
    )
    return body


def _set_friction(root: Element, friction: float) -> None:
    """Give all shapes a coefficient; MuJoCo takes the larger one of two that touch, and there is no friction of turning."""
    SubElement(SubElement(root, "default"), "geom", friction=_numbers((friction, 0.0, 0.0)), condim="3")


def _numbers(values: Iterable[float]) -> str:
    """Return numbers in text, to the last digit."""
    return " ".join(repr(float(value)) for value in values)
