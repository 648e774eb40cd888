"""Obstacles in MuJoCo: a body with one shape for each part, so that all environments have models of one size.

Obstacles at rest are MuJoCo's mocap bodies, which are where they are told to be and have no velocity. Where obstacles move,
all of them are free bodies that gravity leaves alone, so heavy that a vehicle does not move them, and each step begins where
and as fast as the scene has them: contacts see the speed of their surfaces.
Names: ``part0``, ``part1``, ... Letters: E environments, P parts of all obstacles of an environment.
Source: https://mujoco.readthedocs.io/en/stable/modeling.html, on mocap bodies.
"""

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

from aerial_gym.errors import CapabilityError
from aerial_gym.physics.solids import Solid, Solids

HEAVY = 1e9
"""Mass [kg], and moment of inertia [kg m²], of an obstacle that moves: a vehicle of 1 kg yields 1e-9 more than to a wall."""

TOLERANCE = 1e-11 / HEAVY
"""Of the solver where obstacles move: MuJoCo counts it in the mean inertia of all that moves, here of the heavy ones."""

ON_LINKS = "2"
"""The bit by which obstacles touch links; without it shapes of links touch nothing but each other."""

_TYPES = {"box": "box", "sphere": "sphere", "capsule": "capsule", "cylinder": "cylinder", "mesh": "mesh"}


def check_solids(solids: Solids) -> None:
    """Raise ``CapabilityError`` that names a shape which MuJoCo has not."""
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
    """Write the obstacles of one environment, where it has none a part that touches nothing."""
    asset = SubElement(root, "asset")
    for row, solid in enumerate(solids.table):
        if solid.kind == "mesh":
            SubElement(asset, "mesh", name=f"solid{row}", vertex=numbers(x for point in solid.vertices for x in point))
    for place, row in enumerate(solids.part[env].tolist()):
        body = SubElement(world, "body", name=f"part{place}")
        if solids.moves:
            body.set("gravcomp", "1")
            SubElement(body, "freejoint", name=f"part{place}")
            SubElement(body, "inertial", pos="0 0 0", mass=repr(HEAVY), diaginertia=numbers((HEAVY, HEAVY, HEAVY)))
        else:
            body.set("mocap", "true")
        nothing = {"type": "sphere", "size": "1", "contype": "0", "conaffinity": "0"}
        SubElement(body, "geom", _geom(solids.table[row], row) if row >= 0 else nothing)


def _geom(solid: Solid, row: int) -> dict[str, str]:
    geom = {"type": _TYPES[solid.kind], "contype": ON_LINKS, "conaffinity": "0"}
    return geom | ({"mesh": f"solid{row}"} if solid.kind == "mesh" else {"size": numbers(solid.size)})


def numbers(values: Iterable[float]) -> str:
    """Return numbers in text, to the last digit."""
    return " ".join(repr(float(value)) for value in values)
