"""Plot of a robustness test: success rate with its interval, and final error, in every condition, worst first."""

from pathlib import Path
from typing import Any

from aerial_gym.rl_training.robustness.result import Robustness

COLOURS = {
    "fails": "#b0413e",
    "degrades": "#d98e04",
    "holds": "#2a6f97",
    "no change": "#8a8a8a",
    "not shown": "#8a8a8a",
}  # By outcome
ROW_HEIGHT = 0.17  # [inch]


def write_figure(result: Robustness, path: Path) -> None:
    """Write the plot as an image; clean flight is the dashed line."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 1.2 + ROW_HEIGHT * len(result.cells)))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    for outcome, colour in COLOURS.items():
        rows = [(row, each) for row, each in enumerate(result.cells) if each.outcome == outcome]
        for row, each in rows:
            left.plot([100.0 * each.success_low, 100.0 * each.success_high], [row, row], color=colour)
        style: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 3, "linestyle": "none"}
        left.plot([100.0 * each.success_rate for _, each in rows], [row for row, _ in rows], label=outcome, **style)
        errors = [(each.error_mean_m, row) for row, each in rows if each.error_mean_m]
        right.plot([error for error, _ in errors], [row for _, row in errors], **style)
    left.axvline(100.0 * result.clean.success_rate, color="black", linewidth=0.6, linestyle="--", label="clean flight")
    if result.clean.error_mean_m:
        right.axvline(result.clean.error_mean_m, color="black", linewidth=0.6, linestyle="--")
    left.set_yticks(range(len(result.cells)), [each.label for each in result.cells], fontsize=6)
    left.set_ylim(len(result.cells) - 0.5, -0.5)
    left.set_xlabel("success rate and its 95 % interval [%]")
    right.set_xlabel("final error without crash [m]")
    if any(each.error_mean_m for each in (*result.cells, result.clean)):
        right.set_xscale("log")
    left.legend(fontsize=7)
    figure.savefig(path, dpi=120, bbox_inches="tight")
