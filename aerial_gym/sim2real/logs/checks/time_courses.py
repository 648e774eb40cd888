"""Check that a log is one continuous flight: rows follow each other in time, also across clock corrections.

Attitude, position and velocity must change from row to row by their measured rates. Rows of two flights do not.
Letters: T rows, N windows.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.recording import AT_REST, FlightLog
from aerial_gym.sim2real.logs.signals import turns_over_rows

SURPRISE = 1e-3  # Share of ordinary rows whose errors may exceed the reference error of a clock step
WINDOW_ROWS = 50  # Rows per window; the errors of one flight then differ by a tenth between lags
LAGS = (2, 3, 4)  # Distance in rows between rows of the same flight if two alternate; 3 and 4 cover irregular orders
APART = 3.0  # Least ratio of the errors that indicates two flights; it is about 1 within one flight


def check_motion_at_clock_steps(log: FlightLog, times: Sequence[float]) -> None:
    """Raise ``DataError`` if the motion at these corrected clock steps [s] errs more than between other rows as far apart."""
    rows = np.searchsorted(log.time, times)
    rows = rows[(rows > 0) & (rows < log.time.size)]
    if not rows.size:
        return
    passed, motion = np.diff(log.time), errors_of_integrated_rates(log, 1)
    lags = np.rint(passed[rows - 1] / np.median(passed)).astype(int).clip(1, log.time.size - 1)
    for row, lag in zip(rows.tolist(), lags.tolist(), strict=True):
        first = np.arange(log.time.size - lag)
        unaffected = ~((first[:, None] < rows) & (rows <= first[:, None] + lag)).any(axis=1)
        for name, errors in errors_of_integrated_rates(log, lag).items():
            if unaffected.any() and motion[name][row - 1] > APART * np.quantile(errors[unaffected], 1.0 - SURPRISE):
                raise DataError(
                    f"{log.row_name(row)}: the clock was set back there, and the {name} is discontinuous: rows "
                    "are missing, or another flight begins; cut the log there and give both parts as flights"
                )


def check_for_alternating_flights(log: FlightLog) -> None:
    """Raise ``DataError`` if rows of two flights alternate: another than the last row fits far better in two quantities."""
    errors = {lag: errors_of_integrated_rates(log, lag) for lag in (1, *LAGS)}
    names, first = list(errors[1]), LAGS[-1]
    if log.time.size < first + WINDOW_ROWS or len(names) < 2:
        return
    lagged = {name: np.stack([errors[lag][name][first - lag :] for lag in (1, *LAGS)]) for name in names}
    moved = _distances_at_measured_rates(log, first)
    for chooser in names:
        best = 1 + np.argmin(lagged[chooser][1:], axis=0)
        for name in names:
            before, fitting = lagged[name][0], np.take_along_axis(lagged[name], best[None], axis=0)[0]
            apart = _window_means(before) > np.maximum(APART * _window_means(fitting), _window_means(moved[name]))
            if name != chooser and apart.any():
                row = first + int(np.argmax(apart)) * WINDOW_ROWS
                raise DataError(
                    f"{log.row_name(row)}: from there on rows of two flights alternate: the clock was set back, and "
                    "the rows were sorted by time; give the log in the order in which it was written"
                )


def errors_of_integrated_rates(log: FlightLog, lag: int) -> dict[str, Array]:
    """Return change over ``lag`` rows minus integrated rate, as norms (T - lag,): attitude rad, position m, velocity m/s."""
    passed = (log.time[lag:] - log.time[:-lag])[:, None]
    turned = turns_over_rows(log.attitude, lag)
    motion = {"attitude": turned - _mean_rate_over_lag(log.ang_vel, lag, turned) * passed}
    if log.position is not None:
        moved = log.position[lag:] - log.position[:-lag]
        motion["position"] = moved - _mean_rate_over_lag(log.lin_vel, lag, moved) * passed
    if log.lin_vel is not None:
        gained = log.lin_vel[lag:] - log.lin_vel[:-lag]
        motion["velocity"] = gained - _mean_rate_over_lag(_acceleration_in_world(log), lag, gained) * passed
    return {name: np.linalg.norm(values, axis=1) for name, values in motion.items()}


def _acceleration_in_world(log: FlightLog) -> Array | None:
    """Return the acceleration [m/s²], world, (T, 3), from the accelerometer; None without one."""
    if log.specific_force is None:
        return None
    return Rotation.from_quat(log.attitude).apply(log.specific_force) - AT_REST


def _mean_rate_over_lag(rate: Array | None, lag: int, like: Array) -> Array:
    """Return the mean of a rate at both ends of ``lag`` rows, (T - lag, 3); 0 if it was not measured."""
    return np.zeros_like(like) if rate is None else 0.5 * (rate[lag:] + rate[:-lag])


def _distances_at_measured_rates(log: FlightLog, rows: int) -> dict[str, Array]:
    """Return the distance moved over ``rows`` rows at the measured rate, (T - rows,), by quantity; repeats err by less."""
    passed = log.time[rows:] - log.time[:-rows]
    rates = {"attitude": log.ang_vel, "position": log.lin_vel, "velocity": _acceleration_in_world(log)}
    still = np.zeros(passed.size)
    return {n: still if r is None else passed * np.linalg.norm(r[rows:], axis=1) for n, r in rates.items()}


def _window_means(values: Array) -> Array:
    """Return the means over windows of ``WINDOW_ROWS`` rows, (N,)."""
    count = values.size // WINDOW_ROWS
    return values[: count * WINDOW_ROWS].reshape(count, WINDOW_ROWS).mean(axis=1)
