"""Boxes: clutter, panels and walls, which differ in their proportions alone."""

from aerial_gym.assets.families.family import Draw, Family, Range, box
from aerial_gym.config.environment import ShapeCfg


def _make(draw: Draw) -> ShapeCfg:
    return ShapeCfg(kind="box", size=(draw("thickness"), draw("width"), draw("height")))


def _family(summary: str, *, thickness: Range, width: Range, height: Range) -> Family:
    return Family(summary=summary, ranges={"thickness": thickness, "width": width, "height": height}, make=_make)


def _make_doorway(draw: Draw) -> ShapeCfg:
    depth, width, height = draw("thickness"), draw("width"), draw("height")
    door, top = draw("door_width"), draw("door_height")
    side, lintel = 0.5 * (width - door), height - top
    y, z = 0.5 * (door + side), 0.5 * top
    posts = tuple(box((depth, side, height), (0.0, sign * y, 0.0)) for sign in (-1.0, 1.0))
    return ShapeCfg(kind="compound", parts=(*posts, box((depth, door, lintel), (0.0, 0.0, z))))


# Around the boxes, panels and walls of parity 2.2 (0.1x0.5x0.5 to 0.1x1x1 and 0.4 cubes; 0.1x1.2x3; 0.2 thick).
BOXES = _family("Boxes of any proportion", thickness=(0.1, 0.4), width=(0.1, 1.0), height=(0.1, 2.0))
PANELS = _family("Upright panels across x", thickness=(0.1, 0.1), width=(0.8, 1.6), height=(2.0, 4.0))
WALLS = _family("Long walls across x", thickness=(0.2, 0.2), width=(3.0, 6.0), height=(2.5, 4.0))
DOORWAYS = Family(
    summary="Walls across x with an opening in the middle that reaches the floor",
    ranges={
        "thickness": (0.2, 0.2),
        "width": (3.0, 6.0),
        "height": (2.5, 4.0),
        "door_width": (0.8, 1.4),  # of doors in houses
        "door_height": (1.9, 2.3),
    },
    make=_make_doorway,
)
