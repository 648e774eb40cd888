"""Corridors: floor, ceiling and two sides along x, open at both ends, around the origin."""

from aerial_gym.assets.families.family import WALL_IDS, Draw, Family, box
from aerial_gym.config.environment import PartCfg, ShapeCfg


def shell(size: tuple[float, float, float], thickness: float, *faces: str) -> tuple[PartCfg, ...]:
    """Return walls around a centred interior of the given size [m]; faces are named as in ``WALL_IDS``."""
    axes = {"front": (0, 1), "back": (0, -1), "left": (1, 1), "right": (1, -1), "top": (2, 1), "bottom": (2, -1)}
    parts = []
    for face in faces:
        axis, side = axes[face]
        edges, at = [length + 2.0 * thickness for length in size], [0.0, 0.0, 0.0]
        edges[axis], at[axis] = thickness, 0.5 * side * (size[axis] + thickness)
        parts.append(box((edges[0], edges[1], edges[2]), (at[0], at[1], at[2]), WALL_IDS[face]))
    return tuple(parts)


def _make(draw: Draw) -> ShapeCfg:
    inside = (draw("length"), draw("width"), draw("height"))
    return ShapeCfg(kind="compound", parts=shell(inside, draw("thickness"), "left", "right", "bottom", "top"))


CORRIDORS = Family(
    summary="Corridors along x, open at both ends",
    ranges={"length": (8.0, 16.0), "width": (1.5, 3.0), "height": (2.4, 3.0), "thickness": (0.2, 0.2)},
    make=_make,  # widths and heights as in buildings
)
