"""Command line, timing and output of a peer's own process. Imports nothing that is not in Python's library.

A repeat is made of stretches of at most 20 s of simulated time; before each the start is put back, outside the timed span.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

STRETCH_S = 20.0  # Longest simulated time between two restarts [s]
MAX_DISTANCE = 1000.0  # Distance from the start beyond which a vehicle no longer flies [m]


@dataclass(frozen=True, kw_only=True)
class Request:
    """Request of the runner to a peer."""

    case: str  # plant, rk4 or attitude
    num_envs: int  # Vehicles side by side
    vehicles: int = 1  # Vehicles of a world, where a peer has such
    threads: int  # CPU threads; the runner has pinned the process to so many cores
    device: str  # cpu or cuda
    repeats: int  # Figures to take
    repeat_time_s: float  # About how long each is measured [s]


@dataclass(frozen=True, kw_only=True)
class StepBlock:
    """Unit of timing: a block of steps of all vehicles."""

    steps: int  # Steps of each vehicle in a block
    dt: float  # Length of a step [s]
    run: Callable[[], None]  # Do one block; need not wait for a GPU
    restart: Callable[[], None]  # Put the start back
    wait: Callable[[], None]  # Wait until everything is done
    heights: Callable[[], list[float]]  # Return the height of every vehicle [m]


def parse_request(doc: str | None) -> Request:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", required=True)
    parser.add_argument("--num-envs", type=int, required=True)
    parser.add_argument("--vehicles", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--repeat-time-s", type=float, default=0.5)
    return Request(**vars(parser.parse_args()))


def measure_rates(request: Request, batch: StepBlock) -> list[float]:
    """Return steps per second of each repeat, all vehicles together; the flight is checked after each."""
    batch.restart()
    batch.wait()
    before = batch.heights()
    blocks, elapsed = 1, _time_blocks(batch, 1)  # the first one may compile
    while (elapsed := _time_blocks(batch, blocks)) < 0.2 * request.repeat_time_s:
        blocks *= 4
    blocks = max(1, round(blocks * request.repeat_time_s / elapsed))
    rates = []
    for _ in range(request.repeats):
        rates.append(blocks * batch.steps * request.num_envs / _time_blocks(batch, blocks))
        check_flight(before, batch.heights())
    return rates


def _time_blocks(batch: StepBlock, blocks: int) -> float:
    """Return the time of ``blocks`` [s], restarts not counted."""
    longest, elapsed = max(1, int(STRETCH_S / (batch.dt * batch.steps))), 0.0
    while blocks > 0:
        count = min(blocks, longest)
        batch.restart()
        batch.wait()
        begin = time.perf_counter()
        for _ in range(count):
            batch.run()
        batch.wait()
        elapsed += time.perf_counter() - begin
        blocks -= count
    return elapsed


def check_flight(before: list[float], after: list[float]) -> None:
    """Raise ``RuntimeError`` unless every vehicle has moved, and none too far; a NaN fails as well."""
    moved = [abs(end - start) for start, end in zip(before, after, strict=True)]
    if not moved or not all(0.0 < distance < MAX_DISTANCE for distance in moved):
        raise RuntimeError(f"vehicles did not fly: heights changed by {min(moved):.3g} to {max(moved):.3g} m")


def report_rates(request: Request, batch: StepBlock, *, version: str, call: str) -> None:
    """Measure and print one JSON object; ``call`` says how many steps one call makes, and what fuses them."""
    rates = measure_rates(request, batch)
    row = {name: getattr(request, name) for name in ("case", "num_envs", "threads", "device")}
    row |= {"version": version, "dt_s": batch.dt, "call": call, "steps_per_s": statistics.median(rates), "rates": rates}
    print(json.dumps(row))
