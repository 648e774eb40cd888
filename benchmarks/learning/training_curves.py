"""Draw the learning curves that ``benchmarks.learning.training`` printed.

python -m benchmarks.learning.training_curves OUT.png H200=h200.jsonl CPU=cpu.jsonl
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt


def curves(file: Path) -> list[tuple[list[float], list[float]]]:
    """Return training times [s] and errors [m] of each training in a file."""
    result: list[tuple[list[float], list[float]]] = [([], [])]
    for line in file.read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        if "steps_per_s" in row:  # the last line of a training
            result.append(([], []))
        elif "env_steps" in row and row["final_error_mean_m"] is not None:
            result[-1][0].append(row["training_s"])
            result[-1][1].append(row["final_error_mean_m"])
    return [curve for curve in result if curve[0]]


def main(out: str, *named: str) -> None:
    """Draw one panel a file, one line a training."""
    figure, axes = plt.subplots(1, len(named), figsize=(4.5 * len(named), 3.2), sharey=True, squeeze=False)
    for axis, entry in zip(axes[0], named, strict=True):
        name, _, file = entry.partition("=")
        for times, errors in curves(Path(file)):
            axis.plot(times, errors, marker=".", linewidth=1.0)
        for aim in (0.10, 0.03):
            axis.axhline(aim, color="0.7", linewidth=0.8, linestyle="--")
        axis.set(title=name, xlabel="training [s]", yscale="log", xlim=(0.0, None))
    axes[0][0].set_ylabel("error of the last second [m]")
    figure.tight_layout()
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:])
