"""Obstacles in MuJoCo: a body with one shape for each part, so that the models of all environments have equal sizes.

Obstacles at rest are mocap bodies, with prescribed poses and without velocity. If any obstacle moves, all are free bodies
without gravity, too heavy for a vehicle to move. Each step starts them at the poses and velocities of the scene, so that
contacts have the speed of their surfaces.
Names: ``part0``, ``part1``, ... Letters: E environments, P parts of all obstacles of an environment.
Source: https://mujoco.readthedocs.io/en/stable/modeling.html, on mocap bodies.
"""

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

from aerial_gym.errors import CapabilityError
from aerial_gym.physics.solids import Solid, Solids

HEAVY = 1e9
"""Mass [kg] and moment of inertia [kg m²] of a moving obstacle; a vehicle of 1 kg moves it by a share of 1e-9."""

TOLERANCE = 1e-11 / HEAVY
"""Solver tolerance with moving obstacles: MuJoCo scales it by the mean inertia, here that of the heavy bodies."""

ON_LINKS = "2"
"""Contact bit of obstacles and links; shapes of links without it touch each other only."""

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
            SubElement(asset, "mesh", name=f"solid{row}", vertex=numbers(x for point in solid.vertices for x in point))
    for place, row in enumerate(solids.part[env].tolist()):
        body = SubElement(world, "body", name=f"part{place}")
        if solids.moves:
            body.set("gravcomp", "1")
            SubElement(body, "freejoint", name=f"part{place}")
            SubElement(body, "inertial", pos="0 0 0", mass=repr(HEAVY), diaginertia=numbers((HEAVY, HEAVY, HEAVY)))
        else:
            body.set("mocap", "true")
        placeholder = {"type": "sphere", "size": "1", "contype": "0", "conaffinity": "0"}
        SubElement(body, "geom", _geom(solids.table[row], row) if row >= 0 else placeholder)


def _geom(solid: Solid, row: int) -> dict[str, str]:
    geom = {"type": _TYPES[solid.kind], "contype": ON_LINKS, "conaffinity": "0"}
    return geom | ({"mesh": f"solid{row}"} if solid.kind == "mesh" else {"size": numbers(solid.size)})


def numbers(values: Iterable[float]) -> str:
    """Return numbers as text with all digits."""
    return " ".join(repr(float(value)) for value in values)
