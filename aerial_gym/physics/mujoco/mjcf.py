"""MJCF of trees of links and obstacles for MuJoCo; a rigid vehicle is a tree without joints.

Names: bodies ``link0`` (the base), ``link1``, ...; joint k, ``joint0``, ..., moves link k + 1; obstacle parts ``part0``, ...
A body's origin is the link's. The base of a floating tree has a free joint; that of a tree on a stand is a mocap body.
Obstacles have one body for each part, so that the models of all environments have equal sizes. At rest they are mocap
bodies. If any moves, all are free bodies without gravity, too heavy for a vehicle to move, which each step starts at the
poses and velocities of the scene. Letters: E environments, P parts of all obstacles of an environment.
Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html, and modeling.html on mocap bodies.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite, sqrt
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from aerial_gym.config.environment import ContactCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.physics.articulated.tree import Links, Tree
from aerial_gym.physics.ground import LinkContacts, Solid, Solids

HEAVY = 1e9  # Mass [kg] and inertia [kg m²] of a moving obstacle; a vehicle of 1 kg moves it by a share of 1e-9
TOLERANCE = 1e-11 / HEAVY  # Solver tolerance with moving obstacles: MuJoCo scales it by their mean inertia
ON_LINKS = "2"  # Contact bit of obstacles and links; shapes of links without it touch each other only
_TYPES = {"box": "box", "sphere": "sphere", "capsule": "capsule", "cylinder": "cylinder", "mesh": "mesh"}


def check_solids(solids: Solids) -> None:
    """Raise ``CapabilityError`` for a shape that MuJoCo does not support."""
    for solid in solids.table:
        if solid.kind not in _TYPES:
            raise CapabilityError(
                f"backend mujoco: an obstacle that is a {solid.kind} does not push links. Give a box in its place, or "
                "ground_height"
            )
        if not solid.convex:
            raise CapabilityError(
                f"backend mujoco: mesh {solid.path} is not one closed convex body, and MuJoCo would touch its convex hull. "
                "Give a compound of convex parts, or leave contact out of the environment"
            )


def add_solids(root: Element, world: Element, solids: Solids, env: int) -> None:
    """Write the obstacles of one environment; missing parts become shapes without contact."""
    asset = SubElement(root, "asset")
    for row, solid in enumerate(solids.table):
        if solid.kind == "mesh":
            SubElement(
                asset, "mesh", name=f"solid{row}", vertex=format_numbers(x for point in solid.vertices for x in point)
            )
    for place, row in enumerate(solids.part[env].tolist()):
        body = SubElement(world, "body", name=f"part{place}")
        if solids.moves:
            body.set("gravcomp", "1")
            SubElement(body, "freejoint", name=f"part{place}")
            SubElement(
                body, "inertial", pos="0 0 0", mass=repr(HEAVY), diaginertia=format_numbers((HEAVY, HEAVY, HEAVY))
            )
        else:
            body.set("mocap", "true")
        placeholder = {"type": "sphere", "size": "1", "contype": "0", "conaffinity": "0"}
        SubElement(body, "geom", _geom_attributes(solids.table[row], row) if row >= 0 else placeholder)


def _geom_attributes(solid: Solid, row: int) -> dict[str, str]:
    geom = {"type": _TYPES[solid.kind], "contype": ON_LINKS, "conaffinity": "0"}
    return geom | ({"mesh": f"solid{row}"} if solid.kind == "mesh" else {"size": format_numbers(solid.size)})


def format_numbers(values: Iterable[float]) -> str:
    """Return numbers as text with all digits."""
    return " ".join(repr(float(value)) for value in values)


_JOINT_TYPES = {"revolute": "hinge", "prismatic": "slide"}
LEAST_RADIUS = 1e-9  # Radius of a contact point without one [m], because MuJoCo's spheres need a size
IMPEDANCE_RATIO = 100.0  # Ratio of frictional to normal impedance; a sticking contact creeps less by this factor


@dataclass(frozen=True, kw_only=True)
class Floor:
    """A horizontal plane, and the shapes of the vehicle that can touch it."""

    height: float  # Height of the plane [m], world; minus infinity without one
    spheres: Sequence[Sequence[float]]  # Centres x, y, z in the axes of the base, and radii [m]; 0 for a point
    friction: float  # Coulomb coefficient
    on_links: LinkContacts | None = None  # Contacts of an articulated vehicle: links, pairs of shapes, obstacles

    @property
    def solids(self) -> Solids | None:
        """Obstacles with contact to links; None without any."""
        return None if self.on_links is None else self.on_links.solids


def write_mjcf(
    tree: Tree, links: Links, *, env: int = 0, gravity: float, dt: float, integrator: str = "Euler",
    floor: Floor | None = None, actuated: bool = False,
) -> str:  # fmt: skip
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
    option = SubElement(
        root, "option", timestep=repr(dt), integrator=integrator, gravity=format_numbers((0.0, 0.0, -gravity))
    )
    flags = {"warmstart": "disable"}  # makes a step depend on its state only
    world = SubElement(root, "worldbody")
    if floor is None:
        flags |= {"contact": "disable", "constraint": "disable"}
    else:
        option.attrib |= {"cone": "elliptic", "impratio": repr(IMPEDANCE_RATIO)}
        if isfinite(floor.height):
            SubElement(
                world, "geom", name="ground", type="plane", size="0 0 1", pos=format_numbers((0.0, 0.0, floor.height))
            )
        friction = format_numbers(
            (floor.friction, 0.0, 0.0)
        )  # none of torsion; the larger value of two in contact counts
        SubElement(SubElement(root, "default"), "geom", friction=friction, condim="3")
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
        SubElement(body, "geom", type="sphere", pos=format_numbers((x, y, z)), size=size, contype="0")
    if on is None:
        return
    for place, shape in enumerate(on.shapes):
        (x, y, z, w), (_, _, along) = shape.attitude, shape.half
        kind, size = ("capsule", (shape.radius, along)) if along else ("sphere", (shape.radius,))
        if not shape.radius:
            kind, size = "box", shape.half
        attributes = {
            "pos": format_numbers(shape.center),
            "quat": format_numbers((w, x, y, z)),
            "size": format_numbers(size),
        }
        touches = "0" if on.solids is None else ON_LINKS
        SubElement(
            bodies[shape.link], "geom", attributes, name=f"shape{place}", type=kind, contype="0", conaffinity=touches
        )
    contact = SubElement(root, "contact")
    for one, other in on.pairs:
        friction = format_numbers((floor.friction, floor.friction, 0.0, 0.0, 0.0))
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
            gear = format_numbers(float(axis == place) for place in range(6))
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
        body.attrib |= {"pos": format_numbers(joint.position), "quat": format_numbers((w, x, y, z))}
        SubElement(
            body, "joint", name=f"joint{link - 1}", type=_JOINT_TYPES[joint.kind], axis=format_numbers(joint.axis)
        )
    elif tree.floating:
        SubElement(body, "freejoint")
    else:
        body.set("mocap", "true")
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = links.inertia[env, link].tolist()
    SubElement(
        body,
        "inertial",
        pos=format_numbers(links.com[env, link].tolist()),
        mass=repr(float(links.mass[env, link])),
        fullinertia=format_numbers((xx, yy, zz, xy, xz, yz)),
    )
    return body


LEAST_IMPEDANCE = 1e-4  # MuJoCo's smallest impedance, and 1 minus its largest


def contact_softness(cfg: ContactCfg, dt: float) -> float:
    """Return the softness s in (0, 1) for steps of ``dt`` [s]: the share of the stiffness that moves the body.

    MuJoCo's normal force on a mass m with overlap r, normal speed v and acceleration a (out of the surface, negative) is
    ``m / (1 - d) (k r + b v) + m d / (1 - d) a`` with the impedance ``d = 1 - s``. With ``k = s K`` a robot sinks in by
    ``g / K`` for any d, as on a spring of ``K m``. Spring and damper act at the start of a step. Many contacts and long levers
    give at most k / d and b / d, because added mass grows with them. With ``b = 2 zeta sqrt(s K)`` and

        s = (sqrt(1 + beta²) - beta)²,    beta = max(1, zeta) dt sqrt(K)

    ``dt b / d <= 1`` and ``dt² k / d <= 1/4`` hold, where semi-implicit Euler is stable up to 2 and 4.

    Source:
        MuJoCo's documentation, Computation, Constraint model (negative ``solref``). Derived: ``1 - s = 2 beta sqrt(s)`` is
        the first bound as an equality for zeta >= 1.
    """
    beta = max(1.0, cfg.damping_ratio) * dt * sqrt(cfg.stiffness)
    soft = (sqrt(1.0 + beta * beta) - beta) ** 2
    return min(max(soft, LEAST_IMPEDANCE), 1.0 - LEAST_IMPEDANCE)


def solver_numbers(cfg: ContactCfg, dt: float) -> tuple[tuple[float, float], tuple[float, float, float, float, float]]:
    """Return ``solref`` and ``solimp`` of a contact with the parameters of ``cfg``, for steps of ``dt`` [s].

    ``solref`` is minus stiffness and damping per mass [1/s², 1/s]; ``solimp`` is a constant impedance.
    """
    soft = contact_softness(cfg, dt)
    stiffness = soft * cfg.stiffness
    impedance = 1.0 - soft
    return (-stiffness, -2.0 * cfg.damping_ratio * sqrt(stiffness)), (impedance, impedance, 1.0, 0.5, 1.0)
