"""Rooms: six walls around the origin, tables anywhere on the floor, shelves against the long walls."""

from math import pi

from aerial_gym.assets.families.corridors import shell
from aerial_gym.assets.families.family import WALL_IDS, Draw, Family
from aerial_gym.assets.families.furniture import place_parts, shelf_parts, table_parts
from aerial_gym.config.environment import PartCfg, ShapeCfg


def _table(draw: Draw, room: tuple[float, float, float]) -> tuple[PartCfg, ...]:
    length, width = draw.uniform(1.0, 2.0), draw.uniform(0.6, 1.0)  # as the family of tables
    x, y = (max(0.5 * (edge - length), 0.0) for edge in room[:2])
    at = (draw.uniform(-x, x), draw.uniform(-y, y), -0.5 * room[2])
    return place_parts(table_parts(length, width, draw.uniform(0.7, 0.8)), at, draw.uniform(-pi, pi))


def _shelf(draw: Draw, room: tuple[float, float, float], side: float) -> tuple[PartCfg, ...]:
    length, depth, height = draw.uniform(0.6, 1.2), draw.uniform(0.25, 0.4), draw.uniform(1.2, 2.0)
    x = max(0.5 * (room[0] - length), 0.0)
    at = (draw.uniform(-x, x), side * 0.5 * (room[1] - depth), -0.5 * room[2])
    return place_parts(shelf_parts(length, depth, height, 4), at, 0.0)


def _make(draw: Draw) -> ShapeCfg:
    room = (draw("length"), draw("width"), draw("height"))
    parts = list(shell(room, draw("thickness"), *WALL_IDS))
    for _ in range(draw.count("tables")):
        parts += _table(draw, room)
    for i in range(draw.count("shelves")):
        parts += _shelf(draw, room, 1.0 if i % 2 else -1.0)
    return ShapeCfg(kind="compound", parts=tuple(parts))


ROOMS = Family(
    summary="Closed rooms with tables and shelves",
    ranges={
        "length": (5.0, 9.0),  # sizes as in buildings
        "width": (4.0, 7.0),
        "height": (2.5, 3.2),
        "thickness": (0.2, 0.2),
        "tables": (1.0, 4.0),
        "shelves": (1.0, 4.0),
    },
    make=_make,
)
