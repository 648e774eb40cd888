"""Draw how trainings went: ``python -m benchmarks.run_curves OUT.png "RACING=runs/a runs/b" "LANDING=runs/c"``.

A panel for each name, a line for each run folder: the mean return of the episodes that ended, with exploration, over the steps.
"""

import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt

COLUMNS = 3


def curve(folder: Path) -> tuple[list[float], list[float]]:
    """Return steps [million] and mean returns of a run folder; rows before the first episode has ended are left out."""
    with (folder / "curve.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["episode_return"]]
    return [1e-6 * float(row["env_steps"]) for row in rows], [float(row["episode_return"]) for row in rows]


def main(out: str, *named: str) -> None:
    """Draw one panel a name, one line a training."""
    lines = -(-len(named) // COLUMNS)
    figure, axes = plt.subplots(lines, COLUMNS, figsize=(3.6 * COLUMNS, 2.5 * lines), squeeze=False)
    for axis in axes.flat[len(named) :]:
        axis.axis("off")
    for axis, entry in zip(axes.flat, named, strict=False):
        name, _, folders = entry.partition("=")
        for folder in folders.split():
            axis.plot(*curve(Path(folder)), linewidth=0.8)
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=7)
        axis.set_xlim(0.0, None)
    figure.supxlabel("steps [million]", fontsize=9)
    figure.supylabel("return of an episode", fontsize=9)
    figure.tight_layout()
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
