"""Trees: a trunk and branches, all cylinders, standing on the origin."""

from math import cos, pi, sin

from aerial_gym.assets.families.family import Draw, Family
from aerial_gym.config.environment import PartCfg, ShapeCfg

TRUNK, BRANCH = (0.40, 0.28, 0.18), (0.30, 0.46, 0.22)
"""Colours of trunks and branches. Plain choices: bark and leaves."""


def _branch(draw: Draw, tree_height: float) -> PartCfg:
    """Return a rising branch in a random direction, which starts above the lowest third of the trunk."""
    foot = tree_height * draw.uniform(0.35, 1.0)
    length, tilt, heading = draw("branch_length"), 0.5 * pi - draw("rise"), draw.uniform(-pi, pi)
    middle = 0.5 * length
    return PartCfg(
        shape=ShapeCfg(kind="cylinder", radius=draw("branch_radius"), height=length, color=BRANCH),
        position=(middle * sin(tilt) * cos(heading), middle * sin(tilt) * sin(heading), foot + middle * cos(tilt)),
        euler=(0.0, tilt, heading),
    )


def _make(draw: Draw) -> ShapeCfg:
    height = draw("height")
    trunk = ShapeCfg(kind="cylinder", radius=draw("trunk_radius"), height=height, color=TRUNK)
    branches = tuple(_branch(draw, height) for _ in range(draw.count("branches")))
    return ShapeCfg(kind="compound", parts=(PartCfg(shape=trunk, position=(0.0, 0.0, 0.5 * height)), *branches))


TREES = Family(
    summary="Trees of a trunk and branches, standing on the origin",
    ranges={
        "height": (2.0, 4.0),  # of the order of the 4 m of forest_env
        "trunk_radius": (0.04, 0.12),
        "branches": (12.0, 12.0),  # with the trunk the 13 cylinders of parity 2.2
        "branch_length": (0.4, 1.4),
        "branch_radius": (0.01, 0.03),
        "rise": (0.1, 1.1),
    },
    make=_make,
)
