"""Check that a flight log is long and fast enough for a comparison with the simulator, without torch."""

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import turns_over_rows

SHORTEST_S = 2.0
LOWEST_RATE_HZ = 20.0  # Fewest rows per second of a comparison


def check_duration_and_rate(log: FlightLog) -> None:
    """Raise ``DataError`` for a log that is too short or too slow; run this first, as a wrong time unit spoils all checks."""
    span = float(log.time[-1] - log.time[0]) if log.time.size > 1 else 0.0
    if span < SHORTEST_S:
        raise DataError(f"{log.path}: lasts {span:.3g} s, needs at least {SHORTEST_S:g} s; is t in seconds?")
    if sample_rate(log) < LOWEST_RATE_HZ:
        unit = _unit_of_time(log)
        remedy = f"t is in {unit} by the motion: give time unit: {unit} in a mapping file" if unit else "log faster"
        raise DataError(
            f"{log.path}: has {sample_rate(log):.3g} rows per second, needs at least {LOWEST_RATE_HZ:g}; {remedy}"
        )


def _unit_of_time(log: FlightLog) -> str:
    """Return the unit of the time column (ms, us or ns) from the ratio of motion to rate; empty if it is seconds."""
    step = np.diff(log.time)[:, None]
    turned = turns_over_rows(log.attitude, 1)
    pairs = [(turned, log.ang_vel)]
    if log.position is not None:
        pairs.append((np.diff(log.position, axis=0), log.lin_vel))
    moved = [(turn, rate) for turn, rate in pairs if rate is not None and np.any(rate)]
    ratios = [rms_of_vectors(turn) / rms_of_vectors(rate[1:] * step) for turn, rate in moved]
    exponent = round(np.log10(ratios[-1]) / 3.0) if ratios and ratios[-1] > 0.0 else 0
    return {-1: "ms", -2: "us", -3: "ns"}.get(exponent, "")


def rms_of_vectors(values: Array) -> float:
    """Return the root mean square length of vectors, (..., 3)."""
    return float(np.sqrt(np.mean(np.sum(np.square(values), axis=-1))))
