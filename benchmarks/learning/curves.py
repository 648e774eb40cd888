"""Draw learning curves: ``python -m benchmarks.learning.curves OUT.png "RACING=runs/a runs/b" "LANDING=runs/c"``.

A panel for each name, a line for each training. Of a run folder: the mean return of the episodes that ended, with exploration,
over the steps. Of a file with the output of ``benchmarks.learning.training --json`` (``"H200=h200.jsonl"``): the error of the
last second over the training time. A single return that lies far from all others of its panel leaves the picture.
"""

import csv
import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

COLUMNS = 3
FAR = 2.0  # Spans of all but the outermost returns of a panel, from which on one lies far from them
AIMS = (0.10, 0.03)  # Errors that are marked [m]

Curve = tuple[list[float], list[float]]


def run_curve(folder: Path) -> Curve:
    """Return steps [million] and mean returns of a run folder; rows before the first episode has ended are left out."""
    with (folder / "curve.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["episode_return"]]
    return [1e-6 * float(row["env_steps"]) for row in rows], [float(row["episode_return"]) for row in rows]


def error_curves(file: Path) -> list[Curve]:
    """Return training times [s] and errors [m] of each training in a file of ``benchmarks.learning.training``."""
    curves: list[Curve] = [([], [])]
    for row in map(json.loads, file.read_text(encoding="utf-8").splitlines()):
        if "steps_per_s" in row:  # the last line of a training
            curves.append(([], []))
        elif "env_steps" in row and row["final_error_mean_m"] is not None:
            curves[-1][0].append(row["training_s"])
            curves[-1][1].append(row["final_error_mean_m"])
    return [curve for curve in curves if curve[0]]


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
        name, _, places = entry.partition("=")
        files = [Path(place) for place in places.split()]
        errors = [curve for file in files if file.is_file() for curve in error_curves(file)]
        returns = [run_curve(folder) for folder in files if folder.is_dir()]
        for curve in (*errors, *returns):
            axis.plot(*curve, linewidth=0.8)
        if errors:
            axis.set(yscale="log", xlabel="training [s]", ylabel="error of the last second [m]")
            axis.hlines(
                AIMS, 0.0, 1.0, transform=axis.get_yaxis_transform(), color="0.7", linewidth=0.8, linestyle="--"
            )
        else:
            low, high = return_span([value for _, values in returns for value in values])
            axis.set(xlabel="steps [million]", ylabel="return of an episode")
            axis.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=7)
        axis.set_xlim(0.0, None)
    figure.tight_layout()
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
