"""Thin rods: cylinders that images of low resolution miss."""

from aerial_gym.assets.families.family import Draw, Family
from aerial_gym.config.environment import ShapeCfg


def _make(draw: Draw) -> ShapeCfg:
    return ShapeCfg(kind="cylinder", radius=0.5 * draw("thickness"), height=draw("length"))


THIN_RODS = Family(
    summary="Thin rods along z, centred on the origin",
    ranges={"thickness": (0.01, 0.03), "length": (4.0, 5.0)},  # around the 14 mm x 4.89 m of parity 2.2
    make=_make,
)
