"""Plots over time beside the scene. Letters: T samples, P points of a plot."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.viewer.flight_record import PlotPanel

if TYPE_CHECKING:
    from viser import ViserServer, uplot

MOST_POINTS = 1000  # Most points of a line; the panel is some 300 pixels wide
NOW_COLOR = "#888888"


def envelope(time: Array, lines: Array, most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Return times (P,) and lines (lines, P) of at most ``most`` points, which keep every extreme of the T samples.

    Samples are grouped; each group gives its smallest and its largest value, in this order.
    """
    size = -(-2 * time.size // most)
    if size <= 1 or time.size <= most:
        return time, lines
    groups = np.arange(0, time.size, size)
    low, high = np.fmin.reduceat(lines, groups, axis=1), np.fmax.reduceat(lines, groups, axis=1)
    last = np.append(groups[1:], time.size) - 1
    return np.ravel((time[groups], time[last]), order="F"), np.stack((low, high), axis=2).reshape(len(lines), -1)


class TimePlots:
    """Plots of one quantity: the span of time around the present one, with a line at the present."""

    def __init__(self, server: "ViserServer", panels: Sequence[PlotPanel], colors: Mapping[str, str]) -> None:
        self._panels = panels
        self._plots = [
            server.gui.add_uplot(
                tuple(np.zeros(2) for _ in range(len(panel.lines) + 2)),
                (
                    {"label": "t [s]"},
                    *({"label": name, "stroke": colors[name], "width": 1.5} for name in panel.lines),
                    {"label": "now", "stroke": NOW_COLOR, "width": 1, "dash": (4, 4)},
                ),
                title=panel.title,
                scales=_scales((0.0, 1.0)),
                axes=({"label": "t [s]", "labelSize": 16, "size": 30}, {"size": 56}),
                legend={"show": False},
                height=150,
                padding=(8, 24, 0, 0),
            )
            for panel in panels
        ]

    def show(self, time: float, start: float, end: float) -> None:
        """Draw the samples between ``start`` and ``end``, and a line at ``time`` [s]."""
        for plot, panel in zip(self._plots, self._panels, strict=True):
            first, last = np.searchsorted(panel.time, (start, end))
            x, lines = envelope(panel.time[first:last], np.stack([one[first:last] for one in panel.lines.values()]))
            limits = round_limits(lines)
            if (scales := _scales(limits)) != plot.scales:  # rebuilds the plot, so only with other limits
                plot.scales = scales
            place = [int(np.searchsorted(x, time))] * 2
            now = np.full(x.size + 2, np.nan)
            now[place[0] : place[0] + 2] = limits
            plot.data = (np.insert(x, place, time), *np.insert(lines, place, np.nan, axis=1), now)

    def remove(self) -> None:
        """Remove the plots from the page."""
        for plot in self._plots:
            plot.remove()


def round_limits(values: Array) -> tuple[float, float]:
    """Return round limits that contain all finite values, (0, 1) without any."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    step = 10.0 ** np.floor(np.log10(max(high - low, 1e-6 * abs(high), 1e-9)))
    return float(step * np.floor(low / step)), float(step * (np.floor(high / step) + 1.0))


def _scales(limits: tuple[float, float]) -> "dict[str, uplot.Scale]":
    """Return the scales of a plot; uPlot finds no limits of values with NaN itself."""
    return {"x": {"time": False}, "y": {"range": limits}}
