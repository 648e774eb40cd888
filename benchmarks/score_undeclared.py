"""Does the loop name what the undeclared plant hides?

    python -m benchmarks.score_undeclared --seeds 101 102 [--nuisance] [--size moderate] [--json]

One case per effect and seed, and one with nothing hidden. Each row: verdict, effects named, the largest distance of a
parameter from the truth in standard deviations, and the largest residual of force, angular acceleration or rotor speed on the
test flights as a multiple of its noise floor, before and after. The plant shares no code with the package.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from aerial_gym.sim2real import close_loop
from benchmarks.undeclared import EFFECTS, make_case


def score(effect: str | None, *, size: str, seed: int, nuisance: bool, folder: Path) -> dict[str, object]:
    """Return what the loop made of one case."""
    files = make_case(folder / "case", effects={effect: size} if effect else {}, seed=seed, nuisance=nuisance)
    verdict = close_loop(files.robot, files.train, files.test, folder / "loop").as_mapping()
    hidden = json.loads(Path(files.truth).read_text())["effects"] if effect else {}
    named = {e["name"]: e for e in verdict["effects"]}
    worst, inside, total = 0.0, 0, 0
    if effect in named:
        for key, true in hidden[effect].items():
            std = named[effect]["std"].get(key)
            if std:
                z = abs(named[effect]["params"][key] - true) / std
                worst, inside, total = max(worst, z), inside + (z < 1.96), total + 1
    expected = [effect] if effect else []
    return {
        "hidden": effect or "nothing",
        "seed": seed,
        "nuisance": nuisance,
        "verdict": verdict["verdict"],
        "named": list(named),
        "right": list(named) == expected and verdict["verdict"] == ("explained" if effect else "none"),
        "worst_z": worst,
        "inside": inside,
        "intervals": total,
        "before_over_floor": _over_floor(verdict["before"]),
        "after_over_floor": _over_floor(verdict["after"]),
    }


def _over_floor(model: dict[str, dict[str, dict[str, float]]]) -> float:
    """Return the largest residual of force or angular acceleration as a multiple of its noise floor."""
    return max(
        entry["rms"] / entry["noise_floor"]
        for kind in ("specific_force", "angular_acceleration", "rotor_speed")
        for axis, entry in model.get(kind, {}).items()
        if axis != "unit" and "noise_floor" in entry
    )


def main() -> None:
    """Score the cases and print a table and the totals."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--size", default="moderate")
    parser.add_argument("--nuisance", action="store_true", help="small errors everywhere, as real vehicles have")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    args = parser.parse_args()
    rows = []
    if not args.json:
        print("| hidden | seed | verdict | named | right | worst z | before / floor | after / floor |")
        print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for seed in args.seeds:
        for effect in (None, *EFFECTS):
            with tempfile.TemporaryDirectory() as folder:
                row = score(effect, size=args.size, seed=seed, nuisance=args.nuisance, folder=Path(folder))
            rows.append(row)
            print(json.dumps(row) if args.json else _line(row), flush=True)
    if not args.json:
        inside, total = sum(int(r["inside"]) for r in rows), sum(int(r["intervals"]) for r in rows)
        print(
            f"\nright {np.sum([r['right'] for r in rows])} of {len(rows)}; true value inside {inside} of {total} intervals"
        )


def _line(row: dict[str, object]) -> str:
    named = ", ".join(row["named"]) or "-"  # type: ignore[arg-type]
    numbers = f"{row['worst_z']:.2f} | {row['before_over_floor']:.2f} | {row['after_over_floor']:.2f}"
    return f"| {row['hidden']} | {row['seed']} | {row['verdict']} | {named} | {row['right']} | {numbers} |"


if __name__ == "__main__":
    main()
