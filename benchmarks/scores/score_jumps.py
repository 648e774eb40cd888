"""Detection of jumps and frozen sensors that are added to measured flights, and false alarms without them.

    python -m benchmarks.scores.score_jumps --data DATA [--sizes 0.25 0.5 1 2] [--seed 1] [--stream]

DATA has a folder for each collection of flights (docs/results/measured.md). Each flight with position and velocity is read
unchanged, and with a position offset of each size in a random direction, at a random time, for 0.5 to 4 s. Found means both
steps within 0.1 s. With --stream ``Watch`` reads the flights every half second; frozen sensors and offsets that stay are added.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tyro

from aerial_gym.errors import DataError
from aerial_gym.sim2real.failures.rotor_work import BLOCK_S
from aerial_gym.sim2real.failures.watch import LOOK_BLOCKS, WINDOW_S, SensorFault, SensorWatch
from aerial_gym.sim2real.logs.flights import resample_log
from aerial_gym.sim2real.logs.position_jumps import (
    LEAST,
    LIMIT,
    displacement_from_velocity,
    jump_sizes_and_scale,
    mend_position_jumps,
)
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.sample_repeats import SENSORS
from aerial_gym.sim2real.wording import text
from benchmarks.markdown import table, table_row

COLLECTIONS = ("idsia_nanodrone", "nanobench_cf21", "neural_fly", "neural_swarm")
LOOK_S = LOOK_BLOCKS * BLOCK_S
SOON_S = 10.0  # Time after its onset within which a fault should be reported [s]

FAULT_HEADS = (
    *("fault", "flights", "found", f"of these within {SOON_S:g} s", "reported after: median, largest [s]"),
    *("error of the size: median, largest [m]", "other reports"),
)
JUMP_HEADS = ("size [m]", "flights", "found", "error of the size: median, largest [m]", "other jumps reported")


def complete_logs(data: Path) -> Iterator[FlightLog]:
    """Yield the logs with a position and a velocity, at equal time steps."""
    for name in COLLECTIONS:
        for path in sorted((data / name).glob("*.csv")):
            try:
                log = resample_log(read_flight_log(path, mapping=find_mapping(name)))
            except DataError:
                continue
            if log.position is not None and log.lin_vel is not None:
                yield log


def jump_notes(log: FlightLog) -> list[tuple[np.ndarray, float]]:
    """Return size [m] and time [s] of each jump reported in a log."""
    notes = (note for note in mend_position_jumps(replace(log, notes=())).notes if note.code == "position_jump")
    return [(np.array(note.values["size_m"]), note.values["start_s"]) for note in notes]


def largest_share(log: FlightLog) -> float:
    """Return the largest position difference of a log that may be a jump, as a share of the detection limit."""
    assert log.position is not None
    assert log.lin_vel is not None
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    sizes, scale = jump_sizes_and_scale(log.position - displacement_from_velocity(log.lin_vel, step), step)
    return float(np.where(np.abs(sizes) > LEAST, np.abs(sizes) / scale, 0.0).max()) / LIMIT


def stream_faults(log: FlightLog) -> list[tuple[SensorFault, float]]:
    """Return each fault reported while a log grows, and the time of its report [s]."""
    watch, result, start = SensorWatch("flight"), [], log.time[0]
    for end in np.arange(start + LOOK_S, log.time[-1] + LOOK_S, LOOK_S):
        rows = (log.time <= end) & (log.time > end - WINDOW_S)
        seen = {name: values[rows] for name, values in vars(log).items() if isinstance(values, np.ndarray)}
        result += [(fault, float(end)) for fault in watch.find_new_faults(replace(log, **seen))]
    return result


def add_step(
    log: FlightLog, size: float, rng: np.random.Generator, *, returns: bool = True
) -> tuple[FlightLog, np.ndarray, float, float]:
    """Return a log with a position jump, the jump [m], its start and its end [s]; the end counts if it ``returns``."""
    assert log.position is not None
    direction = rng.standard_normal(3)
    step = size * direction / np.linalg.norm(direction)
    begin, end = random_interval(log, rng)
    there = (log.time >= begin) & ((log.time < end) | (not returns))
    return replace(log, position=log.position + there[:, None] * step), step, begin, end


def random_interval(log: FlightLog, rng: np.random.Generator) -> tuple[float, float]:
    """Return the start and end [s] of a random interval of 0.5 to 4 s within a flight."""
    first, last = log.time[0] + 1.0, log.time[-1] - 1.0
    begin = rng.uniform(first, last - 1.0)
    return begin, min(begin + rng.uniform(0.5, 4.0), last)


@dataclass
class Score:
    """Detection score of a watch over flights with one kind of fault."""

    flights: int = 0
    complete: int = 0  # Flights in which all inserted faults are reported
    soon: int = 0  # The same within ``SOON_S`` of each onset
    delays: list[float] = field(default_factory=list)  # From onset to report [s], of all correct reports
    errors: list[float] = field(default_factory=list)  # Of the reported sizes [m]; none of frozen sensors
    false: int = 0  # Reports of faults that were not inserted

    def add(self, hits: list[tuple[float, float | None]], *, inserted: int, reported: int) -> None:
        """Add one flight: delay and error of each correct report, and the numbers of inserted and reported faults."""
        finds_all = len(hits) == inserted
        self.flights += 1
        self.complete += finds_all
        self.soon += finds_all and all(delay <= SOON_S for delay, _ in hits)
        self.delays += [delay for delay, _ in hits]
        self.errors += [error for _, error in hits if error is not None]
        self.false += reported - len(hits)

    def row(self, name: str) -> str:
        """Return a line of the table."""
        spreads = _median_and_largest(self.delays, 2), _median_and_largest(self.errors, 3)
        return table_row((name, self.flights, self.complete, self.soon, *spreads, self.false))


def score_stream(flights: list[FlightLog], sizes: list[float], rng: np.random.Generator) -> None:
    """Print the reports of ``Watch`` for the logs as they are, with jumps, and with frozen sensors."""
    plain = [text(fault.finding) for log in flights for fault, _ in stream_faults(log)]
    print(f"reported as logged: {len(plain)} {plain}")
    print(table(FAULT_HEADS))
    for size in sizes:
        print(jumps_streamed(flights, size, rng).row(f"jump and return, {size:g} m"), flush=True)
    for sensor in SENSORS:
        print(stops_streamed(flights, sensor, rng).row(f"frozen {sensor}"), flush=True)
    for size in sizes:
        print(jumps_streamed(flights, size, rng, returns=False).row(f"jump without return, {size:g} m"), flush=True)


def jumps_streamed(flights: list[FlightLog], size: float, rng: np.random.Generator, *, returns: bool = True) -> Score:
    """Return the detection score of a position fix that jumps by ``size`` [m], and jumps back if it ``returns``."""
    score = Score()
    for log in flights:
        moved, step, begin, end = add_step(log, size, rng, returns=returns)
        told, hits = stream_faults(moved), list[tuple[float, float | None]]()
        for when, true in ((begin, step), (end, -step))[: 1 + returns]:
            near = [(f, at) for f, at in told if abs(f.time - when) < 0.1 and _fault_size(f) @ true > 0.0]
            hits += [(at - when, float(np.linalg.norm(_fault_size(fault) - true))) for fault, at in near[:1]]
        score.add(hits, inserted=1 + returns, reported=len(told))
    return score


def stops_streamed(flights: list[FlightLog], sensor: str, rng: np.random.Generator) -> Score:
    """Return the detection score of a sensor that freezes, over the flights that have it."""
    score = Score()
    for log in flights:
        values = getattr(log, sensor)
        if values is None:
            continue
        begin, end = random_interval(log, rng)
        still, there = values.copy(), (log.time >= begin) & (log.time < end)
        still[there] = values[int(np.argmax(there)) - 1]
        told = stream_faults(replace(log, **{sensor: still}))
        near = [at for f, at in told if f.sensor == sensor and abs(f.time - begin) < 0.1]
        score.add([(at - begin, None) for at in near[:1]], inserted=1, reported=len(told))
    return score


def _fault_size(fault: SensorFault) -> np.ndarray:
    return np.array([fault.params.get(axis, 0.0) for axis in "xyz"])


def _median_and_largest(values: list[float], digits: int) -> str:
    return f"{np.median(values):.{digits}f}, {max(values):.{digits}f}" if values else "-"


@dataclass(frozen=True, kw_only=True)
class JumpScoreCmd:
    """Score the detection of jumps and frozen sensors."""

    data: Path  # Folder with a folder for each collection
    sizes: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0)  # Of the jumps [m]
    seed: int = 1  # Of directions and times
    stream: bool = False  # Let ``Watch`` read the flights

    def run(self) -> None:
        """Print the tables."""
        flights, rng = list(complete_logs(self.data)), np.random.default_rng(self.seed)
        seconds = sum(float(log.time[-1] - log.time[0]) for log in flights)
        flown = f"{len(flights)} flights, {seconds:.0f} s"
        if self.stream:
            print(flown)
            score_stream(flights, list(self.sizes), rng)
            return
        print(f"{flown}: {sum(len(jump_notes(log)) for log in flights)} jumps reported as logged")
        print(f"largest difference as logged: {max(map(largest_share, flights)):.2f} of the limit of a jump")
        print(table(JUMP_HEADS, (jump_cells(flights, size, rng) for size in self.sizes)))


def jump_cells(flights: list[FlightLog], size: float, rng: np.random.Generator) -> tuple[object, ...]:
    """Return the row of jumps of one size [m]: flights, those with both steps found, errors of the size, other jumps."""
    complete, false, errors = 0, 0, []
    for log in flights:
        moved, step, begin, end = add_step(log, size, rng)
        notes = jump_notes(moved)
        near = [
            [jump for jump, at in notes if abs(at - when) < 0.1 and jump @ (sign * step) > 0.0]
            for when, sign in ((begin, 1.0), (end, -1.0))
        ]
        complete += all(len(part) == 1 for part in near)
        false += len(notes) - sum(len(part) for part in near)
        errors += [float(np.linalg.norm(np.abs(part[0]) - np.abs(step))) for part in near if part]
    return f"{size:g}", len(flights), complete, _median_and_largest(errors, 3), false


if __name__ == "__main__":
    tyro.cli(JumpScoreCmd, description=__doc__).run()
