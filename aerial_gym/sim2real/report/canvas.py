"""Grids of panels with fixed margins, and figures as PNG text: a layout that is not searched for is drawn once."""

import base64
import io
from collections.abc import Sequence

import matplotlib

matplotlib.use("Agg", force=False)

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from PIL import Image

DPI = 90
COLOURS = 64
"""Of a figure: lines and letters need no more, and a palette takes a third of the bytes."""

LEFT, RIGHT, TOP, BOTTOM = 0.62, 0.12, 0.3, 0.4
"""Margins of a figure [in]."""


def panels(
    rows: int,
    columns: int,
    *,
    width: float | Sequence[float],
    height: float,
    title: str,
    gap: tuple[float, float] = (0.55, 0.42),
    sharex: bool = False,
) -> tuple[Figure, np.ndarray]:
    """Return a figure of ``rows`` times ``columns`` panels, and these.

    Args:
        rows: Number of rows.
        columns: Number of columns.
        width: Of each panel, or of those of each column [in].
        height: Of each panel [in].
        title: A few words; what the figure shows stands below it, as text of the page.
        gap: Between columns and rows [in].
        sharex: Whether the panels of a column share their axis, whose numbers then stand below the last one.
    """
    widths = [width] * columns if isinstance(width, float | int) else list(width)
    wide = LEFT + sum(widths) + gap[0] * (columns - 1) + RIGHT
    high = TOP + height * rows + gap[1] * (rows - 1) + BOTTOM
    figure = Figure(figsize=(wide, high))
    axes = figure.subplots(
        rows,
        columns,
        squeeze=False,
        sharex="col" if sharex else False,
        gridspec_kw={
            "left": LEFT / wide,
            "right": 1.0 - RIGHT / wide,
            "top": 1.0 - TOP / high,
            "bottom": BOTTOM / high,
            "wspace": gap[0] * columns / sum(widths),
            "hspace": gap[1] / height,
            "width_ratios": widths,
        },
    )
    for axis in axes.ravel():
        axis.tick_params(labelsize=7, length=2.5, pad=2)
        axis.locator_params(nbins=5)
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
    figure.text(LEFT / wide, 1.0 - 0.08 / high, title, fontsize=9, va="top")
    return figure, axes


def legend(figure: Figure, axis: Axes) -> None:
    """Write what the lines of a panel are above all of them, where they hide nothing."""
    wide, high = figure.get_size_inches()
    corner = (1.0 - RIGHT / wide, 1.0 - 0.02 / high)
    lines, labels = axis.get_legend_handles_labels()
    options = {"fontsize": 7, "ncols": len(labels), "frameon": False, "borderpad": 0.2, "handlelength": 1.4}
    figure.legend(lines, labels, loc="upper right", bbox_to_anchor=corner, **options)


def zero_line(axis: Axes) -> None:
    """Draw the line at zero."""
    axis.axhline(0.0, color="black", linewidth=0.4)


def png(figure: Figure) -> str:
    """Return a figure as the text of a PNG with a palette, in base 64."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    buffer = io.BytesIO()
    image.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(buffer, "png")
    return base64.b64encode(buffer.getvalue()).decode("ascii")
