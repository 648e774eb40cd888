"""Fly one case: ``python -m benchmarks.undeclared --out DIR --effect com_offset --size moderate --seed 3``.

With ``--cases`` many cases are flown and scored: ``--loggers px4 --cases 100 --workers 16 --out DIR`` (``score_loggers``), with
``--pairs`` those of two vehicles (``score_pairs``).
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from benchmarks.undeclared import PlantFailure, make_case


@dataclass(frozen=True, kw_only=True)
class CaseCmd:
    """Write the flight logs, the declared robot and the truth of one case."""

    out: Path  # Folder of the case
    effect: tyro.conf.UseAppendAction[tuple[str, ...]] = ()  # Hidden effect; may repeat
    size: Literal["small", "moderate", "large"] = "moderate"  # Size of each effect
    seed: int = 0  # Of values, trajectories and noise
    num_train: int = 4  # Training flights
    num_test: int = 3  # Test flights
    duration_s: float = 16.0  # Length of each log [s]
    rate_hz: int = 400  # Rate of the logs [Hz], a divisor of 400
    logger: Literal["", "rows", "px4", "slow", "gaps", "late", "gps"] = (
        ""  # How the flights are recorded; empty: plain rows
    )
    nuisance: bool = False  # Make mass, rotors, inertia and sensors slightly off

    failure: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """FLIGHT:KIND:KEY=VALUE,... such as test_1:motor_failure:motor=2,scale=0.7,time=5; may repeat."""

    def run(self) -> int:
        """Make the case and print its files; return the exit status."""
        numbers = {
            name: getattr(self, name) for name in ("seed", "num_train", "num_test", "duration_s", "rate_hz", "logger")
        }
        effects = dict.fromkeys(self.effect, self.size)
        try:
            failures = dict(map(parse_failure, self.failure))
            files = make_case(self.out, effects=effects, nuisance=self.nuisance, failures=failures, **numbers)
        except ValueError as error:
            print(error, file=sys.stderr)
            return 2
        for path in (*files.train, *files.test, files.robot, files.truth):
            print(path)
        return 0


def parse_failure(text: str) -> tuple[str, PlantFailure]:
    """Return the flight and the failure of a flag."""
    flight, _, rest = text.partition(":")
    kind, _, pairs = rest.partition(":")
    if "time=" not in pairs:
        raise ValueError(f"--failure {text}: must be FLIGHT:KIND:KEY=VALUE,... with a time")
    values = {key: float(value) for key, _, value in (pair.partition("=") for pair in pairs.split(","))}
    if unknown := set(values) - {"time", "motor", "scale", "duration"}:
        raise ValueError(f"--failure {text}: no {sorted(unknown)}. Known: time, motor, scale, duration")
    return flight, PlantFailure(kind=kind, **values | {"motor": int(values.get("motor", 1))})


def main(arguments: list[str]) -> int:
    """Fly one case, or score many; return the exit status."""
    if "--cases" not in arguments:
        return tyro.cli(CaseCmd, args=arguments, description=__doc__).run()
    from benchmarks.scores.command import run_score

    return run_score(arguments, pairs="--pairs" in arguments, description=__doc__)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
