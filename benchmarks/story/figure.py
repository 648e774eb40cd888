"""The figure of the story: errors of every seed side by side, and one flight of each case over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any


def draw_story(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the figure of rows with ``seed``, ``case``, ``error_m``, ``lost``, and ``trace``: distances [m] at 50 Hz."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.0), width_ratios=(1.0, 1.3), layout="constrained")
    traces: dict[str, list[float]] = {}
    for row in rows:
        traces.setdefault(row["case"], row["trace"])
    colours = ("tab:gray", "tab:red", "tab:blue", "tab:green")
    for place, (case, colour) in enumerate(zip(traces, colours, strict=True)):
        own = [row for row in rows if row["case"] == case]
        errors = [row["error_m"] for row in own]
        left.bar(place, median(errors), color=colour, alpha=0.4, width=0.7)
        left.plot([place] * len(errors), errors, "o", color=colour, markersize=4)
        lost = max(row["lost"] for row in own)
        left.annotate(
            f"{median(errors):.3f} m" + (f"\nlost ≤ {lost:.1%}" if lost else ""),
            (place, max(errors)),
            xytext=(0, 5),
            textcoords="offset points",
            ha="center",
        )
        trace = traces[case]
        right.plot([i / 50.0 for i in range(len(trace))], trace, color=colour, label=case)
    left.set_xticks(
        range(len(traces)), [case.replace(" on ", "\non ").replace(" with ", "\nwith ") for case in traces], fontsize=8
    )
    left.set_ylabel("error at setpoints [m]: every seed, median")
    left.margins(y=0.15)
    right.set_yscale("log")
    right.set_ylim(0.005, 1.5)
    right.set_xlabel("time [s]")
    right.set_ylabel("distance to the setpoint [m]")
    right.legend(fontsize=8, loc="lower center", ncols=2)
    figure.savefig(path, dpi=90)
    plt.close(figure)
