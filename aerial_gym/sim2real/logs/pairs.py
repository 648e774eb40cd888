"""Logs of two vehicles in one flight: each one gets the position of the other vehicle. Letters: T rows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np

from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.position_jumps import mend_position_jumps
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.mapping import LogMapping
from aerial_gym.sim2real.logs.recording import (
    FlightLog,
    FrameOrigin,
    PairMember,
    position_at_times,
    split_flight_number,
)


@dataclass(frozen=True, kw_only=True)
class LogPair:
    """Logs of two vehicles in the same flight, in one world frame."""

    first: str  # Log of one vehicle
    second: str  # Log of the other vehicle

    clock: float = 0.0
    """Added to the times of the second log, which gives those of the first [s]."""

    def __post_init__(self) -> None:
        if _file(self.first) == _file(self.second):
            raise ConfigError(f"--pair {self.first} {self.second}: needs the logs of two vehicles, not one log twice")
        if not isfinite(self.clock):
            raise ConfigError(f"--pair-clock-s {self.clock!r}: must be finite")


def pair_logs(pairs: Sequence[tuple[str | Path, str | Path]], clocks: Sequence[float] = ()) -> list[LogPair]:
    """Return the pairs of logs with their clock offsets [s], 0 where none is given."""
    if len(clocks) > len(pairs):
        raise ConfigError(f"--pair-clock-s: has {len(clocks)} offsets for {len(pairs)} pairs; give one for each --pair")
    offsets = [*clocks, *(0.0 for _ in pairs[len(clocks) :])]
    return [LogPair(first=str(a), second=str(b), clock=c) for (a, b), c in zip(pairs, offsets, strict=True)]


def check_pairs(pairs: Sequence[LogPair], train: Sequence[str | Path], test: Sequence[str | Path]) -> None:
    """Raise ``ConfigError`` unless each pair has a log among the flights and no pair is for training and for testing."""
    roles = [{_file(path) for path in part} for part in (train, test)]
    given = [_file(path) for pair in pairs for path in (pair.first, pair.second)]
    for pair in pairs:
        names, both = f"--pair {pair.first} {pair.second}", [_file(pair.first), _file(pair.second)]
        of_roles = [any(file in role for file in both) for role in roles]
        if not any(of_roles):
            raise ConfigError(f"{names}: neither is in --train or --test; add the logs to identify there")
        if all(of_roles):
            raise ConfigError(
                f"{names}: one is in --train, the other in --test; a flight is for training or for testing"
            )
        if twice := [file for file in both if given.count(file) > 1]:
            raise ConfigError(f"{names}: {twice[0].name} is in another pair too; a log has one other vehicle")


def with_other_vehicle(
    log: FlightLog, pairs: Sequence[LogPair], mapping: LogMapping | None, resample: Callable[[FlightLog], FlightLog]
) -> FlightLog:
    """Return a log with the other vehicle's position in its rows, NaN where unknown; without a pair as it is.

    Local frames of estimators are joined by their geodetic origins. Without these the relative position is unknown.

    ``resample`` gives the other log equal time steps; its position is then mended as that of any log.
    Raise ``DataError`` if the other log cannot be read, has no position, or has no time in common.
    """
    for number, pair in enumerate(pairs):
        for vehicle, (own, other) in enumerate(((pair.first, pair.second), (pair.second, pair.first))):
            if _file(own) == _file(log.path):
                clock = pair.clock if vehicle else 0.0
                ahead = pair.clock - 2.0 * clock  # added to times of the other log, gives those of this one
                member = PairMember(pair=number, vehicle=vehicle, clock=clock)
                return _add_position(log, other, ahead, member, mapping, resample)
    return log


def _add_position(
    log: FlightLog,
    other: str,
    ahead: float,
    member: PairMember,
    mapping: LogMapping | None,
    resample: Callable[[FlightLog], FlightLog],
) -> FlightLog:
    parts = read_flights([other], mapping=mapping)
    place = np.full((log.time.size, 3), np.nan)
    for part in parts:
        if part.position is None:
            raise DataError(
                f"{other}: has no position, which the other vehicle of this flight needs (columns p_x, p_y, p_z)"
            )
        shift = _frame_shift(log.origin, part.origin)
        if shift is None:
            note = Finding("relative_position_unknown", "", {"file": Path(other).name})
            return replace(log, pair=member, notes=(*log.notes, note))
        seen = position_at_times(mend_position_jumps(resample(part)), log.time - ahead) + shift
        place = np.where(np.isnan(place), seen, place)
    known = ~np.isnan(place).any(axis=1)
    if not known.any():
        raise DataError(
            f"{log.path} and {other} have no time in common; give the offset of their clocks (--pair-clock-s)"
        )
    values: dict[str, object] = {"file": Path(other).name, "share": float(known.mean()), "clock_s": ahead}
    if log.position is not None:
        away = np.linalg.norm(place[known] - log.position[known], axis=1)
        values |= {"nearest_m": float(away.min()), "farthest_m": float(away.max())}
    return replace(log, other_position=place, pair=member, notes=(*log.notes, Finding("flown_with", "", values)))


def _frame_shift(own: FrameOrigin | None, other: FrameOrigin | None) -> Array | None:
    """Return the place of the other log's origin in the own frame [m], (3,); None if one log states no origin."""
    if own is None and other is None:
        return np.zeros(3)
    if own is None or other is None or not (own.is_known and other.is_known):
        return None
    return own.local_position(*np.array(other))


def _file(path: str | Path) -> Path:
    """Return the real file of a log, without the number of a flight."""
    return Path(split_flight_number(path)[0]).resolve()
