"""Are jumps found that are put into measured flights, and none where nothing was put?

    python -m benchmarks.score_jumps --data DATA [--sizes 0.25 0.5 1 2] [--seed 1]

DATA holds a folder for each collection of flights (docs/results/measured.md). Every flight with a position and a velocity is
read as it is, and with a fix that moves by each size in a random direction, at a random time, for 0.5 to 4 s. Found: both
steps, each within 0.1 s.
"""

import argparse
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.flights import even_log
from aerial_gym.sim2real.logs.position_jumps import mend_position_jumps
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog

COLLECTIONS = ("idsia_nanodrone", "nanobench_cf21", "neural_fly", "neural_swarm")
TOLD = re.compile(r"position jumps by \(([^)]*)\) m .* t = ([\d.]+)")


def logs(data: Path) -> Iterator[FlightLog]:
    """Yield the logs with a position and a velocity, at equal time steps."""
    for name in COLLECTIONS:
        for path in sorted((data / name).glob("*.csv")):
            try:
                log = even_log(read_flight_log(path, mapping=find_mapping(name)))
            except DataError:
                continue
            if log.position is not None and log.lin_vel is not None:
                yield log


def told(log: FlightLog) -> list[tuple[np.ndarray, float]]:
    """Return size [m] and time [s] of each jump that is told of a log."""
    found = [TOLD.search(note) for note in mend_position_jumps(replace(log, notes=())).notes]
    return [
        (np.array([float(part.split("±")[0]) for part in one[1].split(",")]), float(one[2])) for one in found if one
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--sizes", type=float, nargs="+", default=[0.25, 0.5, 1.0, 2.0])
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    flights, rng = list(logs(args.data)), np.random.default_rng(args.seed)
    seconds = sum(float(log.time[-1] - log.time[0]) for log in flights)
    print(f"{len(flights)} flights, {seconds:.0f} s: {sum(len(told(log)) for log in flights)} jumps told as logged")
    print("| size [m] | flights | both steps found | size, error of the median and the largest [m] | others told |")
    print("| --- | --- | --- | --- | --- |")
    for size in args.sizes:
        right, others, off = 0, 0, []
        for log in flights:
            assert log.position is not None
            direction = rng.standard_normal(3)
            step = size * direction / np.linalg.norm(direction)
            first, last = log.time[0] + 1.0, log.time[-1] - 1.0
            begin = rng.uniform(first, last - 1.0)
            end = min(begin + rng.uniform(0.5, 4.0), last)
            there = (log.time >= begin) & (log.time < end)
            found = told(replace(log, position=log.position + there[:, None] * step))
            near = [
                [(jump, at) for jump, at in found if abs(at - when) < 0.1 and jump @ (sign * step) > 0.0]
                for when, sign in ((begin, 1.0), (end, -1.0))
            ]
            right += all(len(part) == 1 for part in near)
            others += len(found) - sum(len(part) for part in near)
            off += [float(np.linalg.norm(np.abs(part[0][0]) - np.abs(step))) for part in near if part]
        errors = f"{np.median(off):.3f}, {max(off):.3f}" if off else "-"
        print(f"| {size:g} | {len(flights)} | {right} | {errors} | {others} |")


if __name__ == "__main__":
    main()
