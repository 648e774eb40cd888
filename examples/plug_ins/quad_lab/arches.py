"""A family of shapes: arches of two pillars and a beam, with drawn dimensions."""

from aerial_gym.assets.families import Draw, Family
from aerial_gym.config.environment import PartCfg, ShapeCfg

THICKNESS = 0.1  # Edge of pillars and beam [m]


def make_arch(draw: Draw) -> ShapeCfg:
    """Return an arch that is flown through along x, with its origin in the middle of the opening."""
    width, height = draw("width"), draw("height")
    pillar = ShapeCfg(kind="box", size=(THICKNESS, THICKNESS, height))
    beam = ShapeCfg(kind="box", size=(THICKNESS, width + 2.0 * THICKNESS, THICKNESS))
    aside, above = 0.5 * (width + THICKNESS), 0.5 * (height + THICKNESS)
    parts = ((pillar, (0.0, aside, 0.0)), (pillar, (0.0, -aside, 0.0)), (beam, (0.0, 0.0, above)))
    return ShapeCfg(kind="compound", parts=tuple(PartCfg(shape=shape, position=place) for shape, place in parts))


ARCHES = Family(
    summary="Arches of two pillars and a beam", make=make_arch, ranges={"width": (0.8, 1.5), "height": (1.0, 2.0)}
)
