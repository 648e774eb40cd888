"""Input of a run: training and test flights, rejected logs and the checksums of all files."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight, distinct_files, load_flights
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping


@dataclass(frozen=True, kw_only=True)
class FlightInputs:
    """Usable flights, and a finding for each rejected log."""

    train: list[Flight]
    test: list[Flight]
    left_out: tuple[Finding, ...]  # One finding for each rejected log
    digests: dict[str, str]  # SHA-256 of every file by its path, rejected ones included


def read_flight_inputs(
    robot: RobotCfg,
    train: Sequence[str | Path],
    test: Sequence[str | Path],
    *,
    mapping: LogMapping | None,
    bandwidth: float,
) -> FlightInputs:
    """Return the flights of the logs; unusable logs become findings as long as each role keeps a flight, else ``DataError``."""
    if not train or not test:
        raise DataError("needs at least one flight to train on (--train) and another one to test on (--test)")
    check_bandwidth(bandwidth)
    paths, refused = [*train, *test], list[DataError]()
    distinct_files(paths)
    digests = file_digests(paths)
    flights = load_flights(paths, robot, mapping=mapping, bandwidth=bandwidth, learning=len(train), refused=refused)
    to_train = {str(path) for path in train}
    groups = [[f for f in flights if (f.path in to_train) is wanted] for wanted in (True, False)]
    for role, given, left in zip(("train", "test"), (train, test), groups, strict=True):
        if not left:
            refusals = f" (none of {len(given)} flights to {role} on is left; the first refusal of {len(refused)})"
            raise DataError(f"{refused[0]}{refusals if len(refused) > 1 else ''}") from None
    notes = tuple(Finding("flight_left_out", "", {"error": str(error)}) for error in refused)
    return FlightInputs(train=groups[0], test=groups[1], left_out=notes, digests=digests)


def check_bandwidth(bandwidth: float) -> None:
    """Raise ``ConfigError`` for a comparison bandwidth outside 0.5 to 100 Hz."""
    if not 0.5 <= bandwidth <= 100.0:
        raise ConfigError(f"bandwidth_hz = {bandwidth!r}: must lie in [0.5, 100] Hz")


def load_train_and_test(
    robot: RobotCfg,
    train: Sequence[str | Path],
    test: Sequence[str | Path],
    mapping: str | Path | None,
    bandwidth: float,
) -> tuple[list[Flight], list[Flight]]:
    """Return training and test flights; raise ``DataError`` if any log is unusable."""
    layout = None if mapping is None else find_mapping(mapping)
    inputs = read_flight_inputs(robot, train, test, mapping=layout, bandwidth=bandwidth)
    if inputs.left_out:
        raise DataError(f"left out: {inputs.left_out[0].values['error']}")
    return inputs.train, inputs.test


def file_digests(paths: Sequence[str | Path]) -> dict[str, str]:
    """Return the SHA-256 of files by their paths."""
    groups: dict[str, str] = {}
    for path in paths:
        try:
            groups[str(path)] = hashlib.sha256(Path(path).read_bytes()).hexdigest()
        except FileNotFoundError:
            raise DataError(f"{path}: no such file") from None
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    return groups
