"""Inline SVG figures: grids of panels with lines, dots, bars and error bars.

All marks are paths of straight segments, with coordinates in tenths of a pixel. Letters: N points of a mark.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from aerial_gym.sim2real.arrays import Array

INCH = 900  # Drawing units per inch: tenths of a pixel
POINT = INCH / 72  # Drawing units per point, the unit of text and line widths
LEFT, RIGHT, TOP, BOTTOM = 0.62, 0.12, 0.3, 0.4  # Figure margins [in]
MARGIN = 0.05  # Extension of an axis beyond its data on either side, as a share

MOST_TICKS = 6
LETTER = 0.6  # Mean letter width relative to the font size


@dataclass(frozen=True, kw_only=True)
class Mark:
    """Points joined by strokes."""

    x: Array
    y: Array
    together: int  # Points per stroke: all for a line, four for a bar, two for an error bar, one for a dot
    colour: str
    width: float = 0.8  # [pt]
    alpha: float = 1.0
    dashed: bool = False
    filled: bool = False
    label: str = ""


@dataclass(kw_only=True)
class Panel:
    """A frame with axes and marks."""

    place: tuple[float, float, float, float]  # Left, top, width and height
    x_label: str = ""
    y_label: str = ""
    title: str = ""
    log: bool = False  # Whether the vertical axis is logarithmic
    numbered: bool = True  # Whether the horizontal axis has numbers
    names: Sequence[str] = ()  # Category names at 0, 1, 2 ... instead of numbers.
    boxed: bool = False  # Whether the panel has a legend
    levels: list[float] = field(default_factory=list)  # Heights of thin horizontal lines
    marks: list[Mark] = field(default_factory=list)

    def line(self, x: Array, y: Array, colour: str, **style: object) -> None:
        """Draw a line through points."""
        self._add_mark(x, y, max(np.size(x), 1), colour, style)

    def dots(self, x: Array, y: Array, colour: str, **style: object) -> None:
        """Draw a dot at each point."""
        self._add_mark(x, y, 1, colour, style)

    def bars(self, x: Array, height: Array, width: float, colour: str, **style: object) -> None:
        """Draw bars from zero, or from the frame on a logarithmic axis."""
        corners = np.stack([x - width / 2, x - width / 2, x + width / 2, x + width / 2], axis=1)
        zero = np.zeros_like(height)
        self._add_mark(corners, np.stack([zero, height, height, zero], axis=1), 4, colour, {"filled": True, **style})

    def error_bars(self, x: Array, low: Array, high: Array, colour: str, **style: object) -> None:
        """Draw vertical lines between two values."""
        self._add_mark(np.stack([x, x], axis=1), np.stack([low, high], axis=1), 2, colour, style)

    def _add_mark(self, x: Array, y: Array, together: int, colour: str, style: dict) -> None:
        self.marks.append(Mark(x=np.ravel(x), y=np.ravel(y), together=together, colour=colour, **style))

    @property
    def x_values(self) -> Array:
        """Return the horizontal positions of all marks, (N,), or the limits for categories."""
        if self.names:
            return np.array([-0.5, len(self.names) - 0.5])
        return np.concatenate([mark.x for mark in self.marks]) if self.marks else np.zeros(0)

    def svg(self, x_values: Array) -> str:
        """Return the panel as SVG, with a horizontal axis that covers ``x_values``."""
        left, top, wide, high = self.place
        y_values = np.concatenate([np.array(self.levels), *(mark.y for mark in self.marks)])
        x_low, x_high = _axis_limits(x_values)
        y_low, y_high = _axis_limits(np.log10(y_values[y_values > 0.0]) if self.log else y_values)
        if any(mark.filled for mark in self.marks) and not self.log:
            y_low = max(y_low, min(0.0, float(y_values.min())))  # bars stand on the frame

        def to_horizontal_pixels(x: Array) -> Array:
            return left + wide * (x - x_low) / (x_high - x_low)

        def to_vertical_pixels(y: Array) -> Array:
            scaled = np.log10(np.maximum(y, 1e-300)) if self.log else y
            return top + high * (1.0 - np.clip((scaled - y_low) / (y_high - y_low), 0.0, 1.0))

        parts = [_mark_path(mark, to_horizontal_pixels(mark.x), to_vertical_pixels(mark.y)) for mark in self.marks]
        ends = np.array([left, left + wide])
        parts += [
            _stroke_path(ends, to_vertical_pixels(np.full(2, y)), 2, 'stroke="#000" stroke-width="5"')
            for y in self.levels
        ]
        x_ticks = np.arange(len(self.names), dtype=float) if self.names else ticks(x_low, x_high)
        y_ticks = _logarithmic_ticks(y_low, y_high) if self.log else ticks(y_low, y_high)
        bottom, out = top + high, 3 * POINT
        x_at, y_at = to_horizontal_pixels(x_ticks), to_vertical_pixels(y_ticks)
        x_ends = np.concatenate((np.repeat(x_at, 2), np.tile([left - out, left], y_at.size)))
        y_ends = np.concatenate((np.tile([bottom, bottom + out], x_at.size), np.repeat(y_at, 2)))
        parts.append(_stroke_path(x_ends, y_ends, 2, 'stroke="#000" stroke-width="8"'))
        parts.append(
            f'<rect x="{left:.0f}" y="{top:.0f}" width="{wide:.0f}" height="{high:.0f}" '
            'fill="none" stroke="#000" stroke-width="8"/>'
        )
        if self.numbered:
            names = self.names or [_tick_text(x) for x in x_ticks]
            parts += [
                text_element(n, x, bottom + 11 * POINT, anchor="middle") for n, x in zip(names, x_at, strict=True)
            ]
        y_names = zip(map(_tick_text, y_ticks), y_at, strict=True)
        parts += [text_element(name, left - 5 * POINT, y + 2.5 * POINT, anchor="end") for name, y in y_names]
        parts.append(text_element(self.x_label, left + wide / 2, bottom + 21 * POINT, size=8, anchor="middle"))
        parts.append(
            text_element(self.y_label, left - 33 * POINT, top + high / 2, size=8, anchor="middle", turned=True)
        )
        parts.append(text_element(self.title, left, top - 4 * POINT, size=9))
        return "".join([*parts, self._legend() if self.boxed else ""])

    def _legend(self) -> str:
        """Return the legend in the upper corner that the last line avoids."""
        left, top, wide, _ = self.place
        labelled, size = [mark for mark in self.marks if mark.label], 6.5
        width = (max((len(mark.label) for mark in labelled), default=0) * LETTER * size + 16) * POINT
        rising = labelled[-1].y[-1] >= labelled[-1].y[0] if labelled else True
        start, step = left + 4 * POINT if rising else left + wide - width - 4 * POINT, (size + 2) * POINT
        high = len(labelled) * step + 2 * POINT
        parts = [f'<rect x="{start:.0f}" y="{top + 40:.0f}" width="{width:.0f}" height="{high:.0f}" fill="#fffc"/>']
        for place, mark in enumerate(labelled, start=1):
            y = top + 40 + place * step
            parts.append(_legend_stroke(mark, start + 2 * POINT, y - 2 * POINT))
            parts.append(text_element(mark.label, start + 14 * POINT, y, size=size))
        return "".join(parts)


@dataclass(kw_only=True)
class Figure:
    """Panels under a title."""

    title: str
    size: tuple[float, float]  # Width and height
    columns: list[list[Panel]]
    shared: bool  # Whether the panels of a column share a horizontal axis
    legend: Sequence[Mark] = ()  # Marks in the legend above all panels

    def svg(self) -> str:
        """Return the figure as SVG; empty panels stay blank."""
        wide, high = self.size
        parts = [text_element(self.title, LEFT * INCH, 14 * POINT, size=9)]
        at = wide - RIGHT * INCH
        for mark in reversed(self.legend):
            parts.append(text_element(mark.label, at, 10 * POINT, anchor="end"))
            at -= (len(mark.label) * LETTER * 7 + 13) * POINT
            parts.append(_legend_stroke(mark, at, 8 * POINT))
            at -= 12 * POINT
        for column in self.columns:
            drawn = [panel for panel in column if panel.marks or panel.x_label]
            together = [panel.x_values for panel in drawn]
            for own, panel in zip(together, drawn, strict=True):
                parts.append(panel.svg(np.concatenate(together) if self.shared else own))
        return (
            f'<svg role="img" aria-label="{escape(self.title)}" width="{wide / 10:.0f}" height="{high / 10:.0f}" '
            f'viewBox="0 0 {wide:.0f} {high:.0f}" font-family="sans-serif" fill="none">{"".join(parts)}</svg>'
        )


def panels(
    rows: int,
    columns: int,
    *,
    width: float | Sequence[float],
    height: float,
    title: str,
    gap: tuple[float, float] = (0.55, 0.42),
    sharex: bool = False,
) -> tuple[Figure, list[list[Panel]]]:
    """Return a figure of ``rows`` times ``columns`` panels, and the panels row by row.

    Args:
        width: Width of every panel, or of those of each column [in].
        height: Height of each panel [in].
        gap: Gaps between columns and rows [in].
        sharex: Whether the panels of a column share an axis, with numbers below the last one.
    """
    widths = [float(width)] * columns if isinstance(width, float | int) else list(width)
    lefts = LEFT + np.concatenate(([0.0], np.cumsum(np.array(widths) + gap[0])))
    grid = []
    for row in range(rows):
        top, numbered = (TOP + row * (height + gap[1])) * INCH, not sharex or row == rows - 1
        places = [(left * INCH, top, wide * INCH, height * INCH) for left, wide in zip(lefts, widths, strict=False)]
        grid.append([Panel(place=place, numbered=numbered) for place in places])
    size = (lefts[-1] - gap[0] + RIGHT) * INCH, (TOP + rows * (height + gap[1]) - gap[1] + BOTTOM) * INCH
    by_column = [list(column) for column in zip(*grid, strict=True)]
    return Figure(title=title, size=size, columns=by_column, shared=sharex), grid


def ticks(low: float, high: float) -> Array:
    """Return round tick values in steps of 1, 2, 2.5 or 5 times a power of ten, at most about ``MOST_TICKS``."""
    least = (high - low) / MOST_TICKS
    power = 10.0 ** np.floor(np.log10(least))
    step = power * next(factor for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * power >= least)
    return step * np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)


def _logarithmic_ticks(low: float, high: float) -> Array:
    """Return the tick values of a logarithmic axis from log10 limits: powers of ten, or 1, 2 and 5 times one."""
    powers = np.arange(np.ceil(low), np.floor(high) + 1.0)
    if powers.size > 1:
        return 10.0 ** powers[:: -(-powers.size // MOST_TICKS)]
    ticks = np.outer(10.0 ** np.arange(np.floor(low), high + 1.0), [1.0, 2.0, 5.0]).ravel()
    return ticks[(ticks >= 10.0**low) & (ticks <= 10.0**high)]


def _axis_limits(values: Array) -> tuple[float, float]:
    """Return the axis limits with margins."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    span = high - low if high - low > 1e-12 * max(abs(low), abs(high)) else max(abs(low), 1.0)
    return low - MARGIN * span, high + MARGIN * span


def _extremes_of_pixel_columns(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the lowest and highest point in each pixel column, in drawing order; all points if they are few."""
    if x.size <= 4 or x.size <= 2.0 * (x.max() - x.min()) / 10.0:
        return x, y
    column = x // 10.0
    order = np.lexsort((y, column))
    new = np.flatnonzero(np.diff(column[order], prepend=-1.0))
    keep = np.unique(np.concatenate((order[new], order[np.append(new[1:], x.size) - 1])))
    return x[keep], y[keep]


def _mark_path(mark: Mark, x: Array, y: Array) -> str:
    """Return a mark as SVG; non-finite points become gaps."""
    known, style = np.isfinite(x) & np.isfinite(y), _stroke_style(mark)
    if mark.together == 1:
        x, y = np.unique(np.stack((x[known], y[known]), axis=1) // 10.0 * 10.0, axis=0).T  # one dot per pixel
    elif mark.together == x.size:
        gaps = np.flatnonzero(np.diff(known)) + 1
        pieces = zip(np.split(x, gaps), np.split(y, gaps), np.split(known, gaps), strict=True)
        lines = (_extremes_of_pixel_columns(*line) for *line, drawn in pieces if drawn[0])
        return "".join(_stroke_path(*line, line[0].size, style) for line in lines)
    else:
        whole = np.repeat(known.reshape(-1, mark.together).all(axis=1), mark.together)
        x, y = x[whole], y[whole]
    return _stroke_path(x, y, mark.together, style)


def _stroke_style(mark: Mark) -> str:
    if mark.filled:
        return f'fill="{mark.colour}"'
    more = f' stroke-opacity="{mark.alpha:g}"' if mark.alpha < 1.0 else ""
    more += ' stroke-dasharray="50 25"' if mark.dashed else ""
    more += ' stroke-linecap="round"' if mark.together == 1 else ' stroke-linejoin="round"'
    return f'stroke="{mark.colour}" stroke-width="{mark.width * POINT:.0f}"{more}'


def _stroke_path(x: Array, y: Array, together: int, style: str) -> str:
    """Return a path with strokes of ``together`` points each; a single point is a dot."""
    points = np.rint(np.stack((x, y), axis=1)).astype(np.int64).reshape(-1, 2 * together).tolist()
    end = "h0" if together == 1 else ""
    strokes = [f"M{' '.join(map(str, one))}{end}" for one in points]
    return f'<path {style} d="{"".join(strokes)}"/>'


def _legend_stroke(mark: Mark, x: float, y: float) -> str:
    """Return a short legend stroke in the style of a mark."""
    wide = 5.0 if mark.filled or mark.together == 1 else max(mark.width, 1.0)
    style = f'stroke="{mark.colour}" stroke-width="{wide * POINT:.0f}"'
    return _stroke_path(np.array([x, x + 10 * POINT]), np.array([y, y]), 2, style)


def _tick_text(value: float) -> str:
    return f"{value + 0.0:.4g}"


def text_element(
    words: str, x: float, y: float, *, size: float = 7, anchor: str = "start", turned: bool = False
) -> str:
    """Return words at a point, with font size [pt]."""
    if not words:
        return ""
    turn = f' transform="rotate(-90 {x:.0f} {y:.0f})"' if turned else ""
    place = f'x="{x:.0f}" y="{y:.0f}" font-size="{size * POINT:.0f}" text-anchor="{anchor}"'
    return f'<text {place}{turn} fill="#000">{escape(words)}</text>'
