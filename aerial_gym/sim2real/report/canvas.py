"""Figures of a page: plots with lines, dots, bars and error bars as inline SVG, and their labels as HTML.

A plot stretches with the page and labels keep their size, so that both are legible on a telephone. All marks are paths
of straight segments, with coordinates in tenths of a pixel. ``templates/zoom.js`` zooms time axes. Letters: N points of
a mark.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from aerial_gym.sim2real.arrays import Array

INCH = 900  # Drawing units per inch: tenths of a pixel
PIXEL = 10.0  # Drawing units per pixel at the nominal width
POINT = 1.25  # Width of a line of one point [pixel]
LARGEST_STRETCH = 1.6  # Largest width of a figure relative to its nominal width
MARGIN = 0.05  # Extension of an axis beyond its data on either side, as a share

MOST_TICKS = 6
DETAIL = 2  # Pixel columns of a line on a time axis, which zooms, per pixel


@dataclass(frozen=True, kw_only=True)
class Mark:
    """Points joined by strokes."""

    x: Array
    y: Array
    together: int  # Points per stroke: all for a line, four for a bar, two for an error bar, one for a dot
    colour: str  # CSS colour; a variable of `templates/page.css` is legible on dark and light pages
    width: float = 0.8  # [pt]
    alpha: float = 1.0
    dashed: bool = False
    filled: bool = False
    label: str = ""


@dataclass(kw_only=True)
class Panel:
    """A plot with axes and marks."""

    size: tuple[float, float]  # Nominal width and height
    x_label: str = ""
    y_label: str = ""
    title: str = ""
    log: bool = False  # Whether the vertical axis is logarithmic
    square: bool = False  # Whether the plot is square and both axes have the same limits
    numbered: bool = True  # Whether the horizontal axis has numbers
    zooms: bool = False  # Whether the horizontal axis zooms
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

    def html(self, x_values: Array, subject: str = "") -> str:
        """Return the panel as HTML, with a horizontal axis that covers ``x_values``; ``subject`` is the figure's title."""
        y_values = np.concatenate([np.array(self.levels), *(mark.y for mark in self.marks)])
        if self.square:
            x_values = y_values = np.concatenate((x_values, y_values))
        x_axis = _Axis(*_axis_limits(x_values), self.size[0])
        y_low, y_high = _axis_limits(np.log10(y_values[y_values > 0.0]) if self.log else y_values)
        if any(mark.filled for mark in self.marks) and not self.log:
            y_low = max(y_low, min(0.0, float(y_values.min())))  # bars stand on the frame
        y_axis = _Axis(y_low, y_high, self.size[1], log=self.log)
        words = escape(" ".join(filter(None, (subject, self.title, self.y_label))))
        return (
            f'<div class="panel"><div class="head"><b>{escape(self.title)}</b> {escape(self.y_label)}</div>'
            f"{_legend(self.marks) if self.boxed else ''}"
            f'<div class="plot" role="img" aria-label="{words}" {self._plot_style(x_axis, y_axis)}>'
            f'{self._plot(x_axis, y_axis)}</div><div class="foot">{escape(self.x_label)}</div></div>'
        )

    def _plot_style(self, x_axis: "_Axis", y_axis: "_Axis") -> str:
        """Return the height of a plot, and the limits of its axes if it zooms."""
        height = "aspect-ratio:1" if self.square else f"height:{self.size[1] / 10:.0f}px"
        limits = f' data-x="{x_axis.limits}"' + ("" if self.log else f' data-y="{y_axis.limits}"')
        return f'style="{height}"{limits if self.zooms else ""}'

    def _plot(self, x_axis: "_Axis", y_axis: "_Axis") -> str:
        """Return grid, marks and levels as SVG, and the numbers of the axes beside it."""
        wide, high = self.size
        x_ticks = np.arange(len(self.names), dtype=float) if self.names else ticks(x_axis.low, x_axis.high)
        y_ticks = _logarithmic_ticks(y_axis.low, y_axis.high) if self.log else ticks(y_axis.low, y_axis.high)
        x_at, y_at = x_axis.place(x_ticks), high - y_axis.place(y_ticks)
        column = PIXEL / DETAIL if self.zooms else PIXEL
        marks = [_mark_path(mark, x_axis.place(mark.x), high - y_axis.place(mark.y), column) for mark in self.marks]
        levels = "".join(f"M0 {y:.0f}h{wide:.0f}" for y in high - y_axis.place(np.array(self.levels)))
        x_lines = () if self.names else x_at
        grid = "".join([*(f"M{x:.0f} 0v{high:.0f}" for x in x_lines), *(f"M0 {y:.0f}h{wide:.0f}" for y in y_at)])
        x_names = (self.names or [_tick_text(x) for x in x_ticks]) if self.numbered else ()
        names = [_tick_label("x", f"left:{x / wide:.1%}", name) for x, name in zip(x_at, x_names, strict=False)]
        names += [
            _tick_label("y", f"top:{y / high:.1%}", _tick_text(tick)) for y, tick in zip(y_at, y_ticks, strict=True)
        ]
        return (
            f'<svg viewBox="0 0 {wide:.0f} {high:.0f}" preserveAspectRatio="none"><path class="grid" d="{grid}"/>'
            f'{"".join(marks)}<path class="level" d="{levels}"/></svg>{"".join(names)}'
        )


@dataclass(frozen=True)
class _Axis:
    """Limits of an axis, in log10 if it is logarithmic, and its length in drawing units."""

    low: float
    high: float
    size: float
    log: bool = False

    @property
    def limits(self) -> str:
        """Return the limits as text."""
        return f"{self.low:.6g} {self.high:.6g}"

    def place(self, values: Array) -> Array:
        """Return the distances from the low end; those of a logarithmic axis end at its limits."""
        if self.log:
            values = np.clip(np.log10(np.maximum(values, 1e-300)), self.low, self.high)
        return self.size * (values - self.low) / (self.high - self.low)


@dataclass(kw_only=True)
class Figure:
    """Panels under a title."""

    title: str
    columns: list[list[Panel]]
    shared: bool  # Whether the panels of a column share a horizontal axis
    legend: Sequence[Mark] = ()  # Marks in the legend above all panels

    def html(self) -> str:
        """Return the figure as HTML; empty panels stay blank. On a narrow page the columns follow each other."""
        parts = []
        for column in self.columns:
            together = np.concatenate([panel.x_values for panel in column])
            for panel in column:
                drawn = panel.html(together if self.shared else panel.x_values, self.title)
                parts.append(drawn if panel.marks or panel.x_label else "<div></div>")
        widths = [column[0].size[0] for column in self.columns]
        columns, most = " ".join(f"{width:.0f}fr" for width in widths), LARGEST_STRETCH * sum(widths) / PIXEL
        style = f"max-width:{most:.0f}px;grid-template:repeat({len(self.columns[0])},auto)/{columns}"
        return (
            f'<figure><figcaption class="title"><b>{escape(self.title)}</b>{_legend(self.legend)}</figcaption>'
            f'<div class="panels" style="{style}">{"".join(parts)}</div></figure>'
        )


def panels(
    rows: int, columns: int, *, width: float | Sequence[float], height: float, title: str, sharex: bool = False,
    zooms: bool = False,
) -> tuple[Figure, list[list[Panel]]]:  # fmt: skip
    """Return a figure of ``rows`` times ``columns`` panels, and the panels row by row.

    Args:
        width: Nominal width of every panel, or of those of each column [in]. Pages stretch them in this proportion.
        height: Height of each panel [in].
        sharex: Whether the panels of a column share an axis, with numbers below the last one.
        zooms: Whether the horizontal axes zoom.
    """
    widths = [float(width)] * columns if isinstance(width, float | int) else list(width)
    grid = [
        [Panel(size=(w * INCH, height * INCH), numbered=not sharex or row == rows - 1, zooms=zooms) for w in widths]
        for row in range(rows)
    ]
    by_column = [list(column) for column in zip(*grid, strict=True)]
    return Figure(title=title, columns=by_column, shared=sharex), grid


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


def _extremes_of_columns(x: Array, y: Array, width: float) -> tuple[Array, Array]:
    """Return the lowest and highest point in each column of a width, in drawing order; all points if they are few."""
    if x.size <= 4 or x.size <= 2.0 * (x.max() - x.min()) / width:
        return x, y
    column = x // width
    order = np.lexsort((y, column))
    new = np.flatnonzero(np.diff(column[order], prepend=-1.0))
    keep = np.unique(np.concatenate((order[new], order[np.append(new[1:], x.size) - 1])))
    return x[keep], y[keep]


def _mark_path(mark: Mark, x: Array, y: Array, column: float) -> str:
    """Return a mark as SVG; non-finite points become gaps, and long lines keep the extremes of each column."""
    known, style = np.isfinite(x) & np.isfinite(y), _stroke_style(mark)
    if mark.together == 1:
        x, y = np.unique(np.stack((x[known], y[known]), axis=1) // PIXEL * PIXEL, axis=0).T  # one dot per pixel
    elif mark.together == x.size:
        gaps = np.flatnonzero(np.diff(known)) + 1
        pieces = zip(np.split(x, gaps), np.split(y, gaps), np.split(known, gaps), strict=True)
        lines = [_extremes_of_columns(x_part, y_part, column) for x_part, y_part, drawn in pieces if drawn[0]]
        return "".join(_stroke_path(x_part, y_part, x_part.size, style) for x_part, y_part in lines)
    else:
        whole = np.repeat(known.reshape(-1, mark.together).all(axis=1), mark.together)
        x, y = x[whole], y[whole]
    return _stroke_path(x, y, mark.together, style)


def _stroke_style(mark: Mark) -> str:
    if mark.filled:
        return f'style="fill:{mark.colour};stroke:none"'
    more = f";opacity:{mark.alpha:g}" if mark.alpha < 1.0 else ""
    more += ";stroke-dasharray:5 3" if mark.dashed else ""
    more += ";stroke-linecap:round" if mark.together == 1 else ""
    return f'style="stroke:{mark.colour};stroke-width:{mark.width * POINT:.2g}{more}"'


def _stroke_path(x: Array, y: Array, together: int, style: str) -> str:
    """Return a path with strokes of ``together`` points each, the first absolute, the others relative; one is a dot."""
    points = np.rint(np.stack((x, y), axis=1)).astype(np.int64).reshape(-1, together, 2)
    points[:, 1:] = np.diff(points, axis=1)
    strokes = (
        f"M{x} {y}" + (f"l{' '.join(map(str, steps))}" if steps else "h0")
        for x, y, *steps in points.reshape(-1, 2 * together).tolist()
    )
    return f'<path {style} d="{"".join(strokes).replace(" -", "-")}"/>'


def _legend(marks: Sequence[Mark]) -> str:
    """Return the labels of marks as HTML, each behind its colour."""
    keys = (
        f'<span class="key{" dashed" if mark.dashed else ""}" style="--key:{mark.colour}">{escape(mark.label)}</span>'
        for mark in marks
        if mark.label
    )
    return f'<div class="legend">{"".join(keys)}</div>'


def _tick_text(value: float) -> str:
    return f"{value + 0.0:.6g}"


def _tick_label(axis: str, place: str, words: str) -> str:
    return f'<i class="{axis}" style="{place}">{escape(words)}</i>'
