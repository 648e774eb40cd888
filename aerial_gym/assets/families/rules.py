"""Families of shapes: rules with ranges of random dimensions, for boxes, doorways, gates, poles, trees, furniture and rooms.

Lengths in metres, angles in radians; sizes as in buildings and of common furniture where no source is given.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from aerial_gym.config.environment import FIRST_INSTANCE_ID, FamilyCfg, PartCfg, ShapeCfg
from aerial_gym.config.robot import Vec3
from aerial_gym.errors import ConfigError

WALL_IDS = {"front": 9, "back": 10, "left": 11, "right": 12, "bottom": 13, "top": 14}
"""Semantic ids of the faces of rooms and corridors. Source: parity 2.2."""

WALL_COLORS: dict[int, Vec3] = {
    WALL_IDS["front"]: (0.72, 0.74, 0.78), WALL_IDS["back"]: (0.64, 0.66, 0.70), WALL_IDS["left"]: (0.74, 0.70, 0.64),
    WALL_IDS["right"]: (0.66, 0.70, 0.66), WALL_IDS["bottom"]: (0.46, 0.44, 0.42), WALL_IDS["top"]: (0.86, 0.86, 0.84),
}  # fmt: skip
"""Colours of these faces, as in the registered environments. Plain choices."""

assert max(WALL_IDS.values()) < FIRST_INSTANCE_ID

BOARD = 0.03  # Thickness of boards [m]
LEG = 0.05  # Edge of a table's leg [m]
TRUNK, BRANCH = (0.40, 0.28, 0.18), (0.30, 0.46, 0.22)  # Colours of trunks and branches. Plain choices: bark and leaves


class Draw:
    """Random numbers of one variant, drawn in the order of the calls."""

    def __init__(self, ranges: Mapping[str, tuple[float, float]], *, seed: int, variant: int) -> None:
        """Seed the draws of a variant, which depend only on the seed, its number and the ranges."""
        self._ranges, self._random = ranges, np.random.default_rng((seed, variant))

    def __call__(self, name: str) -> float:
        """Draw a declared number, uniform within its range."""
        return self.uniform(*self._ranges[name])

    def uniform(self, low: float, high: float) -> float:
        """Draw a number between two limits, for use inside a rule."""
        return low + (high - low) * float(self._random.random())

    def count(self, name: str) -> int:
        """Draw a declared integer; each value of its range has the same probability."""
        low, high = self._ranges[name]
        return int(self._random.integers(round(low), round(high), endpoint=True))


@dataclass(frozen=True)
class Family:
    """A rule that makes shapes, with the ranges of its numbers."""

    summary: str  # One-line description
    make: Callable[[Draw], ShapeCfg]  # The rule
    ranges: Mapping[str, tuple[float, float]]  # Lowest and highest value of every number

    def shapes(self, cfg: FamilyCfg) -> tuple[ShapeCfg, ...]:
        """Return the variants of a configuration; raise ``ConfigError`` for an unknown number or an impossible shape."""
        for name in cfg.ranges:
            if name not in self.ranges:
                known = ", ".join(self.ranges)
                raise ConfigError(f"family {cfg.name!r}: there is no number {name!r}. Known: {known}")
        ranges = {**self.ranges, **cfg.ranges}
        try:
            return tuple(self.make(Draw(ranges, seed=cfg.seed, variant=i)) for i in range(cfg.variants))
        except ConfigError as error:
            raise ConfigError(f"family {cfg.name!r} with {ranges}: {error}") from None


def box(size: Vec3, at: Vec3, semantic_id: int | None = None) -> PartCfg:
    """Return a box as a part, from its edge lengths and centre [m]."""
    color = None if semantic_id is None else WALL_COLORS.get(semantic_id)
    return PartCfg(shape=ShapeCfg(kind="box", size=size, color=color), position=at, semantic_id=semantic_id)


def make_box(draw: Draw) -> ShapeCfg:
    """Return a box; clutter, panels and walls differ in their proportions alone."""
    return ShapeCfg(kind="box", size=(draw("thickness"), draw("width"), draw("height")))


def make_doorway(draw: Draw) -> ShapeCfg:
    """Return a wall across x with an opening that reaches the floor: two posts and a lintel."""
    depth, width, height = draw("thickness"), draw("width"), draw("height")
    door, top = draw("door_width"), draw("door_height")
    side, lintel = 0.5 * (width - door), height - top
    y, z = 0.5 * (door + side), 0.5 * top
    posts = tuple(box((depth, side, height), (0.0, sign * y, 0.0)) for sign in (-1.0, 1.0))
    return _compound(*posts, box((depth, door, lintel), (0.0, 0.0, z)))


def make_rod(draw: Draw) -> ShapeCfg:
    """Return a thin cylinder, which images of low resolution miss."""
    return ShapeCfg(kind="cylinder", radius=0.5 * draw("thickness"), height=draw("length"))


def make_gate(draw: Draw) -> ShapeCfg:
    """Return a square frame in the plane x = 0 on a stand, with the origin in its middle."""
    opening, bar = draw("opening"), draw("bar")
    width, height = draw("stand_width"), draw("stand_height")
    stand = box((width, width, height), (0.0, 0.0, -0.5 * (opening + height) - bar))
    return _compound(*frame_parts(opening, bar, draw("depth")), stand)


def frame_parts(opening: float, bar: float, depth: float) -> tuple[PartCfg, ...]:
    """Return the four bars of a square frame in the plane x = 0, from opening edge, bar width and depth [m]."""
    outer, middle = opening + 2.0 * bar, 0.5 * (opening + bar)
    level = [box((depth, outer, bar), (0.0, 0.0, side * middle)) for side in (1.0, -1.0)]
    upright = [box((depth, bar, opening), (0.0, side * middle, 0.0)) for side in (1.0, -1.0)]
    return (*level, *upright)


def make_pole(draw: Draw) -> ShapeCfg:
    """Return an upright pole with round ends, whose top is the origin."""
    height = draw("height")
    pole = ShapeCfg(kind="capsule", radius=0.5 * draw("thickness"), height=height)
    return _compound(PartCfg(shape=pole, position=(0.0, 0.0, -0.5 * height)))


def make_tree(draw: Draw) -> ShapeCfg:
    """Return a trunk and branches, all cylinders, standing on the origin."""
    height = draw("height")
    trunk = ShapeCfg(kind="cylinder", radius=draw("trunk_radius"), height=height, color=TRUNK)
    branches = tuple(_make_branch(draw, height) for _ in range(draw.count("branches")))
    return _compound(PartCfg(shape=trunk, position=(0.0, 0.0, 0.5 * height)), *branches)


def _make_branch(draw: Draw, tree_height: float) -> PartCfg:
    """Return a rising branch in a random direction, which starts above the lowest third of the trunk."""
    foot = tree_height * draw.uniform(0.35, 1.0)
    length, tilt, heading = draw("branch_length"), 0.5 * pi - draw("rise"), draw.uniform(-pi, pi)
    middle = 0.5 * length
    return PartCfg(
        shape=ShapeCfg(kind="cylinder", radius=draw("branch_radius"), height=length, color=BRANCH),
        position=(middle * sin(tilt) * cos(heading), middle * sin(tilt) * sin(heading), foot + middle * cos(tilt)),
        euler=(0.0, tilt, heading),
    )


def make_table(draw: Draw) -> ShapeCfg:
    """Return a table on the origin."""
    return _compound(*table_parts(draw("length"), draw("width"), draw("height")))


def table_parts(length: float, width: float, height: float) -> tuple[PartCfg, ...]:
    """Return the parts of a table: a top along x and four legs; outer sizes [m]."""
    leg, x, y = height - BOARD, 0.5 * (length - LEG), 0.5 * (width - LEG)
    corners = [(i * x, j * y, 0.5 * leg) for i in (-1.0, 1.0) for j in (-1.0, 1.0)]
    top = box((length, width, BOARD), (0.0, 0.0, height - 0.5 * BOARD))
    return (top, *(box((LEG, LEG, leg), at) for at in corners))


def make_shelf(draw: Draw) -> ShapeCfg:
    """Return a shelf on the origin."""
    return _compound(*shelf_parts(draw("length"), draw("depth"), draw("height"), draw.count("boards")))


def shelf_parts(length: float, depth: float, height: float, boards: int) -> tuple[PartCfg, ...]:
    """Return the parts of a shelf along x, open at front and back: two sides and evenly spaced boards; outer sizes [m]."""
    x = 0.5 * (length - BOARD)
    sides = tuple(box((BOARD, depth, height), (side * x, 0.0, 0.5 * height)) for side in (-1.0, 1.0))
    inner = length - 2.0 * BOARD
    heights = [0.5 * BOARD + i * (height - BOARD) / max(boards - 1, 1) for i in range(boards)]
    return (*sides, *(box((inner, depth, BOARD), (0.0, 0.0, z)) for z in heights))


def place_parts(parts: tuple[PartCfg, ...], at: Vec3, yaw: float) -> tuple[PartCfg, ...]:
    """Return upright parts after a rotation about z by ``yaw`` [rad] and a displacement ``at`` [m]."""
    c, s, moved = cos(yaw), sin(yaw), []
    for part in parts:
        x, y, z = part.position
        place = (at[0] + c * x - s * y, at[1] + s * x + c * y, at[2] + z)
        turn = (0.0, 0.0, part.euler[2] + yaw)
        moved.append(PartCfg(shape=part.shape, position=place, euler=turn, semantic_id=part.semantic_id))
    return tuple(moved)


def make_corridor(draw: Draw) -> ShapeCfg:
    """Return floor, ceiling and two sides along x, open at both ends, around the origin."""
    inside = (draw("length"), draw("width"), draw("height"))
    return _compound(*room_wall_parts(inside, draw("thickness"), "left", "right", "bottom", "top"))


def room_wall_parts(size: Vec3, thickness: float, *faces: str) -> tuple[PartCfg, ...]:
    """Return walls around a centred interior of the given size [m]; faces are named as in ``WALL_IDS``."""
    axes = {"front": (0, 1), "back": (0, -1), "left": (1, 1), "right": (1, -1), "top": (2, 1), "bottom": (2, -1)}
    parts = []
    for face in faces:
        axis, side = axes[face]
        edges, at = [length + 2.0 * thickness for length in size], [0.0, 0.0, 0.0]
        edges[axis], at[axis] = thickness, 0.5 * side * (size[axis] + thickness)
        parts.append(box((edges[0], edges[1], edges[2]), (at[0], at[1], at[2]), WALL_IDS[face]))
    return tuple(parts)


def make_room(draw: Draw) -> ShapeCfg:
    """Return six walls around the origin, tables anywhere on the floor, and shelves against the long walls."""
    room = (draw("length"), draw("width"), draw("height"))
    parts = list(room_wall_parts(room, draw("thickness"), *WALL_IDS))
    for _ in range(draw.count("tables")):
        parts += _place_table(draw, room)
    for i in range(draw.count("shelves")):
        parts += _place_shelf(draw, room, 1.0 if i % 2 else -1.0)
    return _compound(*parts)


def _place_table(draw: Draw, room: Vec3) -> tuple[PartCfg, ...]:
    length, width = draw.uniform(*TABLES.ranges["length"]), draw.uniform(*TABLES.ranges["width"])
    x, y = (max(0.5 * (edge - length), 0.0) for edge in room[:2])
    at = (draw.uniform(-x, x), draw.uniform(-y, y), -0.5 * room[2])
    parts = table_parts(length, width, draw.uniform(*TABLES.ranges["height"]))
    return place_parts(parts, at, draw.uniform(-pi, pi))


def _place_shelf(draw: Draw, room: Vec3, side: float) -> tuple[PartCfg, ...]:
    length, depth, height = (draw.uniform(*SHELVES.ranges[name]) for name in ("length", "depth", "height"))
    x = max(0.5 * (room[0] - length), 0.0)
    at = (draw.uniform(-x, x), side * 0.5 * (room[1] - depth), -0.5 * room[2])
    return place_parts(shelf_parts(length, depth, height, 4), at, 0.0)


def _compound(*parts: PartCfg) -> ShapeCfg:
    return ShapeCfg(kind="compound", parts=parts)


BOXES = Family(  # these three around the boxes, panels and walls of parity 2.2: 0.1x0.5x0.5 to 0.1x1x1 and 0.4 cubes
    "Boxes of any proportion", make_box, {"thickness": (0.1, 0.4), "width": (0.1, 1.0), "height": (0.1, 2.0)}
)
PANELS = Family(  # 0.1x1.2x3
    "Upright panels across x", make_box, {"thickness": (0.1, 0.1), "width": (0.8, 1.6), "height": (2.0, 4.0)}
)
WALLS = Family(  # 0.2 thick
    "Long walls across x", make_box, {"thickness": (0.2, 0.2), "width": (3.0, 6.0), "height": (2.5, 4.0)}
)
DOORWAYS = Family(  # of doors in houses
    "Walls across x with an opening in the middle that reaches the floor", make_doorway,
    {**WALLS.ranges, "door_width": (0.8, 1.4), "door_height": (1.9, 2.3)},
)  # fmt: skip
THIN_RODS = Family(  # around the 14 mm x 4.89 m of parity 2.2
    "Thin rods along z, centred on the origin", make_rod, {"thickness": (0.01, 0.03), "length": (4.0, 5.0)}
)
GATES = Family(  # from the gate of github learnsyslab/lsy_drone_racing (envs/assets/gate.xml) to twice its size
    "Square frames on a stand, to be flown through along x; the origin is the middle of the opening", make_gate,
    {
        "opening": (0.4, 0.8), "bar": (0.16, 0.32), "depth": (0.02, 0.04),
        "stand_width": (0.1, 0.2), "stand_height": (1.0, 2.0),
    },
)  # fmt: skip
POLES = Family(  # from its obstacle.xml, likewise
    "Upright poles with round ends, whose tops are the origin", make_pole,
    {"thickness": (0.03, 0.06), "height": (1.5, 3.0)},
)  # fmt: skip
TREES = Family(
    "Trees of a trunk and branches, standing on the origin", make_tree,
    {
        "height": (2.0, 4.0),  # of the order of the 4 m of forest_env
        "trunk_radius": (0.04, 0.12),
        "branches": (12.0, 12.0),  # with the trunk the 13 cylinders of parity 2.2
        "branch_length": (0.4, 1.4), "branch_radius": (0.01, 0.03), "rise": (0.1, 1.1),
    },
)  # fmt: skip
TABLES = Family(
    "Tables of a top and four legs, standing on the origin", make_table,
    {"length": (1.0, 2.0), "width": (0.6, 1.0), "height": (0.7, 0.8)},
)  # fmt: skip
SHELVES = Family(
    "Shelves of two sides and boards, standing on the origin", make_shelf,
    {"length": (0.6, 1.2), "depth": (0.25, 0.4), "height": (1.2, 2.0), "boards": (3.0, 6.0)},
)  # fmt: skip
CORRIDORS = Family(
    "Corridors along x, open at both ends", make_corridor,
    {"length": (8.0, 16.0), "width": (1.5, 3.0), "height": (2.4, 3.0), "thickness": (0.2, 0.2)},
)  # fmt: skip
ROOMS = Family(
    "Closed rooms with tables and shelves", make_room,
    {
        "length": (5.0, 9.0), "width": (4.0, 7.0), "height": (2.5, 3.2), "thickness": (0.2, 0.2),
        "tables": (1.0, 4.0), "shelves": (1.0, 4.0),
    },
)  # fmt: skip
