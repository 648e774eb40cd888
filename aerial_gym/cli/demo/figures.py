"""Pictures of the demo page, as PNG data for an ``img`` tag."""

import base64
import csv
import io
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]


def figure_as_data_url(figure: Figure) -> str:
    """Return a figure as ``data:image/png;base64,...``."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def camera_figure(depth: NDArray[np.float32], segmentation: NDArray[np.int32], max_range: float) -> Figure:
    """Return depth above segmentation for some environments, each (n, H, W)."""
    count = len(depth)
    figure = Figure(figsize=(3.2 * count, 4.2), layout="constrained")
    axes = figure.subplots(2, count, squeeze=False)
    ids = np.unique(segmentation)
    colors = ListedColormap(np.random.default_rng(3).uniform(0.15, 0.95, (len(ids), 3)))
    shown = np.where(depth < 0.0, np.nan, depth)
    image = None
    for i in range(count):
        image = axes[0, i].imshow(shown[i], cmap="viridis_r", vmin=0.0, vmax=max_range)
        axes[1, i].imshow(np.searchsorted(ids, segmentation[i]), cmap=colors, interpolation="nearest")
        axes[0, i].set_title(f"environment {i}", fontsize=9)
        for row in (0, 1):
            axes[row, i].set_xticks([])
            axes[row, i].set_yticks([])
    axes[0, 0].set_ylabel("depth")
    axes[1, 0].set_ylabel("segmentation")
    if image is not None:
        figure.colorbar(image, ax=axes[0, :].tolist(), label="depth [m]", shrink=0.9)
    return figure


def learning_figure(curve_file: Path) -> Figure:
    """Return the mean return of an episode over training time."""
    with curve_file.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["episode_return"]]
    figure = Figure(figsize=(6.0, 3.2), layout="constrained")
    axis = figure.subplots()
    axis.plot([float(row["time_s"]) for row in rows], [float(row["episode_return"]) for row in rows])
    axis.set_xlabel("training time [s]")
    axis.set_ylabel("mean return of an episode")
    axis.grid(alpha=0.3)
    return figure


def flights_figure(paths: Array, dt: float) -> Figure:
    """Return distance to the target over time, and the paths from above; ``paths`` (T, n, 3) are errors [m]."""
    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    time = dt * np.arange(len(paths))
    left.semilogy(time, np.linalg.norm(paths, axis=-1), lw=0.8, alpha=0.8)
    left.axhline(0.1, color="k", ls="--", lw=0.8)
    left.set_xlabel("time [s]")
    left.set_ylabel("distance to the target [m]")
    left.grid(alpha=0.3)
    right.plot(paths[..., 0], paths[..., 1], lw=0.8, alpha=0.8)
    right.plot(0.0, 0.0, "k*", ms=10)
    right.set_aspect("equal", adjustable="datalim")
    right.set_xlabel("x [m]")
    right.set_ylabel("y [m]")
    right.grid(alpha=0.3)
    return figure
