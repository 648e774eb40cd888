"""Furniture: tables and shelves of boxes, standing on the origin."""

from math import cos, sin

from aerial_gym.assets.families.family import Draw, Family, box
from aerial_gym.config.environment import PartCfg, ShapeCfg

_BOARD = 0.03
"""Thickness of boards [m], as of common furniture."""

_LEG = 0.05
"""Edge of a table's leg [m], likewise."""


def table_parts(length: float, width: float, height: float) -> tuple[PartCfg, ...]:
    """Return the parts of a table: a top along x and four legs; outer sizes [m]."""
    leg, x, y = height - _BOARD, 0.5 * (length - _LEG), 0.5 * (width - _LEG)
    corners = [(i * x, j * y, 0.5 * leg) for i in (-1.0, 1.0) for j in (-1.0, 1.0)]
    top = box((length, width, _BOARD), (0.0, 0.0, height - 0.5 * _BOARD))
    return (top, *(box((_LEG, _LEG, leg), at) for at in corners))


def shelf_parts(length: float, depth: float, height: float, boards: int) -> tuple[PartCfg, ...]:
    """Return the parts of a shelf along x, open at front and back: two sides and evenly spaced boards; outer sizes [m]."""
    x = 0.5 * (length - _BOARD)
    sides = tuple(box((_BOARD, depth, height), (side * x, 0.0, 0.5 * height)) for side in (-1.0, 1.0))
    inner = length - 2.0 * _BOARD
    heights = [0.5 * _BOARD + i * (height - _BOARD) / max(boards - 1, 1) for i in range(boards)]
    return (*sides, *(box((inner, depth, _BOARD), (0.0, 0.0, z)) for z in heights))


def place_parts(parts: tuple[PartCfg, ...], at: tuple[float, float, float], yaw: float) -> tuple[PartCfg, ...]:
    """Return upright parts after a rotation about z by ``yaw`` [rad] and a displacement ``at`` [m]."""
    c, s = cos(yaw), sin(yaw)
    return tuple(
        PartCfg(
            shape=part.shape,
            position=(
                at[0] + c * part.position[0] - s * part.position[1],
                at[1] + s * part.position[0] + c * part.position[1],
                at[2] + part.position[2],
            ),
            euler=(0.0, 0.0, part.euler[2] + yaw),
            semantic_id=part.semantic_id,
        )
        for part in parts
    )


def _make_table(draw: Draw) -> ShapeCfg:
    return ShapeCfg(kind="compound", parts=table_parts(draw("length"), draw("width"), draw("height")))


def _make_shelf(draw: Draw) -> ShapeCfg:
    parts = shelf_parts(draw("length"), draw("depth"), draw("height"), draw.count("boards"))
    return ShapeCfg(kind="compound", parts=parts)


# Sizes of common furniture.
TABLES = Family(
    summary="Tables of a top and four legs, standing on the origin",
    ranges={"length": (1.0, 2.0), "width": (0.6, 1.0), "height": (0.7, 0.8)},
    make=_make_table,
)
SHELVES = Family(
    summary="Shelves of two sides and boards, standing on the origin",
    ranges={"length": (0.6, 1.2), "depth": (0.25, 0.4), "height": (1.2, 2.0), "boards": (3.0, 6.0)},
    make=_make_shelf,
)
