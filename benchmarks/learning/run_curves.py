"""Draw learning curves: ``python -m benchmarks.learning.run_curves OUT.png "RACING=runs/a runs/b" "LANDING=runs/c"``.

A panel for each name, a line for each run folder: the mean return of the episodes that ended, with exploration, over the steps.
A single return that lies far from all others of its panel leaves the picture.
"""

import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

COLUMNS = 3

FAR = 2.0  # Spans of all but the outermost returns of a panel, from which on one lies far from them


def run_curve(folder: Path) -> tuple[list[float], list[float]]:
    """Return steps [million] and mean returns of a run folder; rows before the first episode has ended are left out."""
    with (folder / "curve.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["episode_return"]]
    return [1e-6 * float(row["env_steps"]) for row in rows], [float(row["episode_return"]) for row in rows]


def return_span(returns: list[float]) -> tuple[float, float]:
    """Return lowest and highest of the returns that do not lie far from the others."""
    low, high = np.quantile(returns, (0.01, 0.99))
    near = [value for value in returns if low - FAR * (high - low) <= value <= high + FAR * (high - low)]
    return min(near), max(near)


def main(out: str, *named: str) -> None:
    """Draw one panel a name, one line a training."""
    columns = min(COLUMNS, len(named))
    lines = -(-len(named) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(3.6 * columns, 2.5 * lines), squeeze=False)
    for axis in axes.flat[len(named) :]:
        axis.axis("off")
    for axis, entry in zip(axes.flat, named, strict=False):
        name, _, folders = entry.partition("=")
        curves = [run_curve(Path(folder)) for folder in folders.split()]
        for steps, returns in curves:
            axis.plot(steps, returns, linewidth=0.8)
        low, high = return_span([value for _, returns in curves for value in returns])
        axis.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=7)
        axis.set_xlim(0.0, None)
    figure.supxlabel("steps [million]", fontsize=9)
    figure.supylabel("return of an episode", fontsize=9)
    figure.tight_layout()
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
