"""Bring the streams of one flight onto the samples of the gyro. Letters: T rows."""

from collections.abc import Mapping
from dataclasses import replace
from math import inf

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flight_spans import FlightSpan
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.signals import IN_BAND, interpolate_by_spline, interpolate_columns, mean_of_held_values
from aerial_gym.sim2real.logs.streams import Stream

GYRO_RATES_HZ = (50.0, 2000.0)  # Range of rates in which the gyro gives the rows
SLOWEST_COMMANDS_HZ = 40.0  # Lowest rate of rotor data that show torques and lags: two samples in a lag of 0.05 s


def row_times(streams: Mapping[str, Stream], span: FlightSpan, fastest: float = inf) -> Array:
    """Return the times of the rows of a flight [s], (T,): those of the gyro, or else of the fastest stream of motion.

    Rows above 2000 Hz, or above ``fastest``, are thinned.
    """
    gyro = streams.get("ang_vel")
    low, high = GYRO_RATES_HZ
    clocks = [one for name, one in streams.items() if name in ("ang_vel", "attitude", "rotor_speed", "rotor_command")]
    base = gyro if gyro is not None and gyro.rate >= low else max(clocks, key=lambda stream: stream.rate)
    thinned = base.time[:: max(1, round(base.rate / min(high, fastest)))]
    return thinned[(thinned >= span.start) & (thinned <= span.end)]


def resample_streams(streams: Mapping[str, Stream], rows: Array) -> dict[str, Array]:
    """Return the values of each stream at the rows [s], (T, components).

    Attitudes are interpolated on the sphere, held commands averaged from a row to the next, other streams averaged about a
    row or interpolated, those of ``IN_BAND`` by a spline. Slow commands are interpolated too: they are rare samples of fast
    commands, and holding them would delay these by half a sample.
    """
    return {name: _resample(stream, rows) for name, stream in streams.items()}


def without_slow_rotor_data(log: FlightLog, rates: Mapping[str, float]) -> FlightLog:
    """Return the log without the lags and torques that rotor data at native ``rates`` [Hz], by quantity, do not show."""
    logged = [name for name in ("rotor_speed", "rotor_command") if getattr(log, name) is not None]
    slow = [name for name in logged if rates.get(name, inf) < SLOWEST_COMMANDS_HZ]
    if not slow:
        return log
    torques = log.torques and logged[0] not in slow  # measured speeds come before commands
    values = {"torques": torques}
    notes = [Finding("rotors_too_slow", "", {"quantity": name, "rate_hz": rates[name]} | values) for name in slow]
    return replace(
        log,
        rotor_command=log.rotor_command if log.rotor_speed is None else None,  # a lag needs both, fast
        torques=torques,
        notes=tuple(dict.fromkeys((*log.notes, *notes))),
    )


def _resample(stream: Stream, rows: Array) -> Array:
    time, values = stream.time, stream.values
    own = np.clip(np.searchsorted(time, rows), None, time.size - 1)
    if np.array_equal(time[own], rows) and np.array_equal(np.diff(own), np.ones(rows.size - 1)):
        return values[own]
    step = float(np.median(np.diff(rows)))
    first, last = np.searchsorted(time, (rows[0] - 2.0 * step, rows[-1] + 2.0 * step))
    part = slice(max(first - 2, 0), last + 2)  # a long log has many flights
    time, values = time[part], values[part]
    if stream.quantity == "attitude":
        inside = np.clip(rows, time[0], time[-1])
        after = np.clip(np.searchsorted(time, inside, side="right"), 1, time.size - 1)
        used = np.unique(np.concatenate((after - 1, after)))
        return Slerp(time[used], Rotation.from_quat(values[used]))(inside).as_quat()
    if stream.quantity == "rotor_command" and stream.rate >= SLOWEST_COMMANDS_HZ:
        return mean_of_held_values(rows, time, values, step)
    first, last = (np.searchsorted(time, rows + side * 0.5 * step) for side in (-1.0, 1.0))
    has_several = last - first >= 2
    interpolate = interpolate_by_spline if stream.quantity in IN_BAND else interpolate_columns
    between = np.empty((rows.size, values.shape[1])) if has_several.all() else interpolate(rows, time, values)
    if has_several.any():
        means = _average_over_rows(rows, time, values, step, first, last)
        between[has_several] = means[has_several]
    return between


def _average_over_rows(rows: Array, time: Array, values: Array, step: float, first: Indices, last: Indices) -> Array:
    """Return the means of values (T, K) over each row's step [s], in which samples ``first`` to before ``last`` lie."""
    total = np.concatenate((np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)))
    centre = np.concatenate(([0.0], np.cumsum(time - time[0])))
    count = np.maximum(last - first, 1)
    mean = (total[last] - total[first]) / count[:, None]
    # The mean belongs to the mean time of its samples; the local slope moves it to the row.
    shift = rows - time[0] - (centre[last] - centre[first]) / count
    ends = (interpolate_columns(rows + side * 0.5 * step, time, values) for side in (1.0, -1.0))
    return mean + shift[:, None] * np.subtract(*ends) / step
