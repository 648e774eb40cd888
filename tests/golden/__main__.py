"""``python -m tests.golden [TOPIC ...]``: compare golden results with the reference files; ``--update`` rewrites these."""

import argparse
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.golden.compare import RELATIVE, differences, is_machine_bound, read, write
from tests.golden.worker import machine, measure_all

REFERENCE = Path(__file__).parent / "reference"

TOPICS: tuple[str, ...] = ("interface", "releases", "cases", "tasks")
"""Modules of this package with ``items``, ``measure`` and ``TOLERANCE_ELSEWHERE``."""


def report(topic: str, items: dict[str, Any], names: dict[str, bool], *, whole: bool) -> bool:
    """Print the differences of a topic from its reference; return whether there are none that count."""
    reference = read(REFERENCE / f"{topic}.json")
    same = reference["machine"] == machine()
    elsewhere = import_module(f"tests.golden.{topic}").TOLERANCE_ELSEWHERE
    old = {name: part for name, part in reference["items"].items() if name in items or (whole and name not in names)}
    lines = list(differences(old, items, topic, relative=RELATIVE if same else max(elsewhere, RELATIVE)))
    counted = [line for line in lines if same or not is_machine_bound(line)]
    for line in counted:
        print(line)
    if notes := len(lines) - len(counted):
        print(f"{topic}: {notes} differences by rounding only, on another machine than {reference['machine']}")
    return not counted


def update(file: Path, items: dict[str, Any], *, whole: bool) -> None:
    """Write results to a reference file; other entries stay unless these are all.

    Raises:
        SystemExit: If a result is an error, or the entries that stay are of another machine.
    """
    if failed := [f"{file.stem}/{name}: {parts['error']}" for name, parts in items.items() if "error" in parts]:
        raise SystemExit("\n".join(failed))
    reference = read(file)
    if not whole and reference["machine"] not in ("", machine()):
        raise SystemExit(f"{file.name}: written on {reference['machine']}; update all of its entries here, not some")
    kept = {} if whole else reference["items"]
    write(file, {"machine": machine(), "items": kept | items})


def arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("topics", nargs="*", help=f"of {', '.join(TOPICS)}; all if not given")
    parser.add_argument("--update", action="store_true", help="write the reference files")
    parser.add_argument("--quick", action="store_true", help="only the items that run with every test run")
    parser.add_argument("--only", default="", help="only items whose name contains this text")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes side by side")
    args = parser.parse_args()
    if unknown := set(args.topics) - set(TOPICS):
        parser.error(f"no topic {', '.join(sorted(unknown))}. Known: {', '.join(TOPICS)}")
    return args


def main() -> int:
    """Run the command; return 0 if nothing differs, else 1."""
    args = arguments()
    names = {topic: import_module(f"tests.golden.{topic}").items() for topic in args.topics or TOPICS}
    jobs = [
        (topic, item)
        for topic, items in names.items()
        for item, quick in items.items()
        if quick >= args.quick and args.only in item
    ]
    results: dict[str, dict[str, Any]] = {topic: {} for topic in names}
    spent: dict[str, float] = dict.fromkeys(names, 0.0)
    for topic, item, result, seconds in measure_all(jobs, args.jobs):
        results[topic][item] = result
        spent[topic] += seconds
    print("processor time: " + ", ".join(f"{topic} {seconds:.0f} s" for topic, seconds in spent.items()))
    whole = not args.quick and not args.only
    if args.update:
        for topic, items in results.items():
            update(REFERENCE / f"{topic}.json", items, whole=whole)
        return 0
    good = [report(topic, items, names[topic], whole=whole) for topic, items in results.items()]
    print("golden results: no difference" if all(good) else "golden results differ; see CONTRIBUTING.md")
    return int(not all(good))


if __name__ == "__main__":
    sys.exit(main())
