"""Picture of test images and their reconstructions."""

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from aerial_gym.config.storage import storage_errors


def draw_reconstructions(rows: Mapping[str, Tensor], path: Path, *, largest: float) -> None:
    """Write images of shares of a largest distance [m], (N, H, W) of each row by its title, near ones dark."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(next(iter(rows.values())))
    _, height, width = next(iter(rows.values())).shape
    figure = Figure(figsize=(1.9 * count + 0.8, 2.1 * len(rows) * height / width + 0.6), dpi=100, layout="constrained")
    axes = figure.subplots(len(rows), count, squeeze=False)
    shown = None
    for line, (title, images) in zip(axes, rows.items(), strict=True):
        for place, image in zip(line, images, strict=True):
            shown = place.imshow(image.cpu().numpy() * largest, vmin=0.0, vmax=largest, cmap="viridis")
            place.set_xticks([])
            place.set_yticks([])
        line[0].set_ylabel(title, fontsize=9)
    if shown is not None:
        figure.colorbar(shown, ax=axes, label="m", shrink=0.8)
    with storage_errors(path):
        FigureCanvasAgg(figure).print_figure(path)
