"""Rules of the families of shapes: boxes, doorways, gates, poles, rods, trees, furniture, corridors and rooms.

Lengths in metres, angles in radians; sizes as in buildings and of common furniture where no source is given.
"""

from math import cos, pi, sin

from aerial_gym.assets.families.family import WALL_IDS, Draw, Family, box
from aerial_gym.config.environment import PartCfg, ShapeCfg

Size = tuple[float, float, float]

BOARD = 0.03  # Thickness of boards [m]
LEG = 0.05  # Edge of a table's leg [m]
TRUNK, BRANCH = (0.40, 0.28, 0.18), (0.30, 0.46, 0.22)  # Colours of trunks and branches. Plain choices: bark and leaves


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


def place_parts(parts: tuple[PartCfg, ...], at: Size, yaw: float) -> tuple[PartCfg, ...]:
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
    return _compound(*wall_parts(inside, draw("thickness"), "left", "right", "bottom", "top"))


def wall_parts(size: Size, thickness: float, *faces: str) -> tuple[PartCfg, ...]:
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
    parts = list(wall_parts(room, draw("thickness"), *WALL_IDS))
    for _ in range(draw.count("tables")):
        parts += _place_table(draw, room)
    for i in range(draw.count("shelves")):
        parts += _place_shelf(draw, room, 1.0 if i % 2 else -1.0)
    return _compound(*parts)


def _place_table(draw: Draw, room: Size) -> tuple[PartCfg, ...]:
    length, width = draw.uniform(*TABLES.ranges["length"]), draw.uniform(*TABLES.ranges["width"])
    x, y = (max(0.5 * (edge - length), 0.0) for edge in room[:2])
    at = (draw.uniform(-x, x), draw.uniform(-y, y), -0.5 * room[2])
    parts = table_parts(length, width, draw.uniform(*TABLES.ranges["height"]))
    return place_parts(parts, at, draw.uniform(-pi, pi))


def _place_shelf(draw: Draw, room: Size, side: float) -> tuple[PartCfg, ...]:
    length, depth, height = (draw.uniform(*SHELVES.ranges[name]) for name in ("length", "depth", "height"))
    x = max(0.5 * (room[0] - length), 0.0)
    at = (draw.uniform(-x, x), side * 0.5 * (room[1] - depth), -0.5 * room[2])
    return place_parts(shelf_parts(length, depth, height, 4), at, 0.0)


def _compound(*parts: PartCfg) -> ShapeCfg:
    return ShapeCfg(kind="compound", parts=parts)


# Around the boxes, panels and walls of parity 2.2 (0.1x0.5x0.5 to 0.1x1x1 and 0.4 cubes; 0.1x1.2x3; 0.2 thick).
BOXES = Family(
    summary="Boxes of any proportion",
    ranges={"thickness": (0.1, 0.4), "width": (0.1, 1.0), "height": (0.1, 2.0)},
    make=make_box,
)
PANELS = Family(
    summary="Upright panels across x",
    ranges={"thickness": (0.1, 0.1), "width": (0.8, 1.6), "height": (2.0, 4.0)},
    make=make_box,
)
WALLS = Family(
    summary="Long walls across x",
    ranges={"thickness": (0.2, 0.2), "width": (3.0, 6.0), "height": (2.5, 4.0)},
    make=make_box,
)
DOORWAYS = Family(
    summary="Walls across x with an opening in the middle that reaches the floor",
    ranges={**WALLS.ranges, "door_width": (0.8, 1.4), "door_height": (1.9, 2.3)},  # of doors in houses
    make=make_doorway,
)
THIN_RODS = Family(
    summary="Thin rods along z, centred on the origin",
    ranges={"thickness": (0.01, 0.03), "length": (4.0, 5.0)},  # around the 14 mm x 4.89 m of parity 2.2
    make=make_rod,
)
GATES = Family(
    summary="Square frames on a stand, to be flown through along x; the origin is the middle of the opening",
    # from the gate of github learnsyslab/lsy_drone_racing (envs/assets/gate.xml) to twice its size
    ranges={
        "opening": (0.4, 0.8),
        "bar": (0.16, 0.32),
        "depth": (0.02, 0.04),
        "stand_width": (0.1, 0.2),
        "stand_height": (1.0, 2.0),
    },
    make=make_gate,
)
POLES = Family(
    summary="Upright poles with round ends, whose tops are the origin",
    ranges={"thickness": (0.03, 0.06), "height": (1.5, 3.0)},  # from its obstacle.xml, likewise
    make=make_pole,
)
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
    make=make_tree,
)
TABLES = Family(
    summary="Tables of a top and four legs, standing on the origin",
    ranges={"length": (1.0, 2.0), "width": (0.6, 1.0), "height": (0.7, 0.8)},
    make=make_table,
)
SHELVES = Family(
    summary="Shelves of two sides and boards, standing on the origin",
    ranges={"length": (0.6, 1.2), "depth": (0.25, 0.4), "height": (1.2, 2.0), "boards": (3.0, 6.0)},
    make=make_shelf,
)
CORRIDORS = Family(
    summary="Corridors along x, open at both ends",
    ranges={"length": (8.0, 16.0), "width": (1.5, 3.0), "height": (2.4, 3.0), "thickness": (0.2, 0.2)},
    make=make_corridor,
)
ROOMS = Family(
    summary="Closed rooms with tables and shelves",
    ranges={
        "length": (5.0, 9.0),
        "width": (4.0, 7.0),
        "height": (2.5, 3.2),
        "thickness": (0.2, 0.2),
        "tables": (1.0, 4.0),
        "shelves": (1.0, 4.0),
    },
    make=make_room,
)
