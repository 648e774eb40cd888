"""In what flights of one vehicle differ: the mean of measured minus predicted in each, with its standard error.

    python -m benchmarks.scores.flight_offsets --data DATA --set idsia --effects h_force_flapping rotor_inertia

The named effects are fitted to the training flights of a set (``benchmarks.scores.score_measured``), the tolerances not: what
is left is what sensors, alignment and balance of each flight add. Standard errors count independent rows alone.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.scores.score_measured import SETS

Array = np.ndarray


def mean_and_error(residual: Array) -> tuple[Array, Array]:
    """Return the mean of each column of a residual (T, C) and its standard error, each (C,)."""
    from aerial_gym.sim2real.identify.least_squares.moments import effective_share

    rows = len(residual) * effective_share(residual)
    return residual.mean(axis=0), residual.std(axis=0) / np.sqrt(rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Print a row for each flight; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder with a folder for each collection")
    parser.add_argument("--set", choices=SETS, required=True, metavar="SET", help=", ".join(SETS))
    parser.add_argument("--effects", nargs="+", required=True, help="what may be fitted")
    args = parser.parse_args(argv)
    if not args.data.is_dir():
        print(f"{args.data}: no such folder", file=sys.stderr)
        return 2

    from aerial_gym.interop import one_thread
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.sim2real.identify.selection.scoring import Criteria
    from aerial_gym.sim2real.identify.stages import declare, select
    from aerial_gym.sim2real.logs.inputs import load_train_and_test
    from aerial_gym.sim2real.predict.tolerances import Tolerances
    from aerial_gym.sim2real.progress import silent

    found = SETS[args.set]
    with tempfile.TemporaryDirectory() as folder, one_thread():
        files = [of(args.data, Path(folder)) for of in (found.train, found.test)]
        robot = robot_by_name(found.robot)
        train, test = load_train_and_test(robot, *files, found.mapping, found.bandwidth)
        declared = declare(robot, train, test, bandwidth=found.bandwidth, tolerances=Tolerances())
        chosen = select(declared, Criteria(), silent, candidates=args.effects).selection.chosen
    print(f"fitted: {', '.join(chosen.effects) or 'nothing'}; mean ± standard error")
    print("\t".join(("flight", *(channel.name for channel in declared.channels))))
    for predictor in (declared.train, declared.test):
        for flight, residual in zip(predictor.flights, predictor.residuals(chosen.named.params), strict=True):
            pairs = zip(*mean_and_error(residual), strict=True)
            print("\t".join((flight.name, *(f"{mean:+.3f} ± {error:.3f}" for mean, error in pairs))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
