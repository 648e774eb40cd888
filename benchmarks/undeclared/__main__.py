"""Command line: ``python -m benchmarks.undeclared --out DIR --effect com_offset --size moderate --seed 3``."""

import argparse
import sys
from pathlib import Path

from benchmarks.undeclared import EFFECTS, FEATURES, LOGGED, SIZES, TRACKED, UNKNOWN, PlantFailure, make_case


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.undeclared", description=__doc__)
    repeat = {"action": "append", "default": []}
    parser.add_argument("--out", type=Path, required=True, help="folder of the case")
    known = (*EFFECTS, *UNKNOWN)
    parser.add_argument("--effect", **repeat, choices=known, metavar="EFFECT", help="hidden; may repeat")
    parser.add_argument(
        "--pair", nargs=2, default=[], metavar="EFFECT", help="two hidden at once: two --effect in one flag"
    )
    parser.add_argument("--size", default="moderate", choices=SIZES, help="size of every --effect")
    parser.add_argument("--param", **repeat, metavar="EFFECT.KEY=VALUE", help="explicit value, SI; may repeat")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--num-train", type=int, default=4)
    parser.add_argument("--num-test", type=int, default=3)
    parser.add_argument("--duration-s", type=float, default=16.0)
    parser.add_argument("--rate-hz", type=int, default=400)
    parser.add_argument("--feature", **repeat, choices=FEATURES, help="of the flights, beside what effects need")
    failure = "in flight, e.g. test_1:motor_failure:motor=2,scale=0.7,time=5; may repeat"
    parser.add_argument("--failure", **repeat, metavar="FLIGHT:KIND:KEY=VALUE,...", help=failure)
    parser.add_argument("--nuisance", action="store_true", help="make mass, rotors, inertia and sensors slightly off")
    parser.add_argument("--tracked", action="store_true", help="and markers and, flight by flight, the accelerometer")
    parser.add_argument("--logged", action="store_true", help="and sensors late, the accelerometer's scale and place")
    return parser


def _flag_effects(sized: list[str], size: str, params: list[str]) -> dict[str, str | dict[str, float]]:
    """Return the effects of the flags; an explicit value replaces the size of its effect."""
    effects: dict[str, str | dict[str, float]] = dict.fromkeys(sized, size)
    for text in params:
        name, _, number = text.partition("=")
        effect, _, key = name.partition(".")
        values = effects.get(effect)
        if not isinstance(values, dict):
            values = effects[effect] = {}
        values[key] = float(number)
    return effects


def _flag_failures(flags: list[str]) -> dict[str, PlantFailure]:
    """Return the failures of the flags by flight."""
    result = {}
    for text in flags:
        parts = text.split(":")
        if len(parts) != 3 or "time=" not in parts[2]:
            raise ValueError(f"--failure {text}: must be FLIGHT:KIND:KEY=VALUE,... with a time")
        values = {key: float(value) for key, _, value in (pair.partition("=") for pair in parts[2].split(","))}
        if unknown := set(values) - {"time", "motor", "scale", "duration"}:
            raise ValueError(f"--failure {text}: no {sorted(unknown)}. Known: time, motor, scale, duration")
        result[parts[0]] = PlantFailure(kind=parts[1], **values | {"motor": int(values.get("motor", 1))})
    return result


def main(argv: list[str] | None = None) -> int:
    """Make the case that the flags ask for; return the exit status."""
    args = _parser().parse_args(argv)
    try:
        files = make_case(
            args.out,
            effects=_flag_effects([*args.effect, *args.pair], args.size, args.param),
            seed=args.seed,
            num_train=args.num_train,
            num_test=args.num_test,
            duration_s=args.duration_s,
            nuisance=LOGGED if args.logged else TRACKED if args.tracked else args.nuisance,
            rate_hz=args.rate_hz,
            features=args.feature,
            failures=_flag_failures(args.failure),
        )
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    for path in (*files.train, *files.test, files.robot, files.truth):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
